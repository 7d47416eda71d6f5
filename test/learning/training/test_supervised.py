# SPDX-License-Identifier: Apache-2.0
"""Training: it learns, repeats, balances the modalities, and can express the papers' recipe."""

import dataclasses

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose

from foretouch.errors import DatasetError
from foretouch.learning.data import Dataset, TrainingSet, duplicate_labels, labels_of, make_folds
from foretouch.learning.data.training_set import predict_set
from foretouch.learning.evaluation.baselines import object_mean, training_mean
from foretouch.learning.evaluation.evaluate import cross_validate
from foretouch.learning.training.losses import labeled_loss
from foretouch.learning.training.run import make_learner
from foretouch.learning.training.run_config import RunConfig
from foretouch.learning.training.supervised import SupervisedTrainer, TrainConfig, train_network
from foretouch.models.network.checkpoint import NetworkEstimator
from foretouch.models.network.folding import fold
from foretouch.models.network.length_check import LengthRangeCheck
from foretouch.models.touch_model import TouchModel
from foretouch.tactile import MODALITIES, modality_size
from foretouch.types import Touch

SIZES = [modality_size(name) for name in MODALITIES]

QUICK = TrainConfig(epochs=60, batch_size=8, learning_rate=5e-3)


def test_it_learns_what_can_be_learned_and_beats_the_mean(samples, small) -> None:
    data = TrainingSet.build(samples, small)
    trainer = SupervisedTrainer(data, np.arange(45), QUICK)
    losses = [trainer.run_epoch()["loss"] for _ in range(60)]
    net = train_network(data, np.arange(45), QUICK)
    assert all(torch.equal(value, net.state_dict()[name]) for name, value in trainer.net.cpu().state_dict().items())
    assert losses[-1] < 0.3 * losses[0]
    predicted = predict_set(net, data, np.arange(45, 60))
    actual = data.labels[45:]
    assert np.mean((predicted - actual) ** 2) < 0.5 * np.mean((data.labels[:45].mean(axis=0) - actual) ** 2)


def test_the_seed_decides_dropout_too_and_leaves_the_global_generator(samples, small) -> None:
    data = TrainingSet.build(samples, small.replace(head_dropout=0.5))
    short = QUICK.replace(epochs=2)
    state = torch.random.get_rng_state()
    one = train_network(data, np.arange(40), short).state_dict()
    assert torch.equal(torch.random.get_rng_state(), state)
    torch.rand(3)
    two = train_network(data, np.arange(40), short).state_dict()
    assert all(torch.equal(one[key], two[key]) for key in one)
    other = train_network(data, np.arange(40), short.replace(seed=5)).state_dict()
    assert not torch.equal(one["output.weight"], other["output.weight"])


def test_training_does_not_see_the_held_out_labels(samples, small) -> None:
    changed = [
        sample if i < 40 else dataclasses.replace(sample, touch=Touch(3000.0, 2000.0, np.ones(24), np.ones(24)))
        for i, sample in enumerate(samples)
    ]
    short = QUICK.replace(epochs=1)
    one = train_network(TrainingSet.build(samples, small), np.arange(40), short).state_dict()
    two = train_network(TrainingSet.build(changed, small), np.arange(40), short).state_dict()
    assert all(torch.equal(one[key], two[key]) for key in one)


@pytest.mark.parametrize(("precision", "atol"), [("float32", 0.05), ("bfloat16", 1e-3)])
def test_validation_predicts_what_the_model_predicts(samples, small, precision: str, atol: float) -> None:
    small = small.replace(precision=precision)
    data = TrainingSet.build(samples, small)
    net = train_network(data, np.arange(40), QUICK.replace(epochs=2))
    model = TouchModel(NetworkEstimator(small, fold(net)), {"name": "toy", "sha256": ""})
    (prediction,) = model.predict(samples[50].cloud, [samples[50].grasp])
    assert_allclose(prediction.value.vector(), predict_set(net, data, np.array([50]))[0], atol=atol)


def test_what_was_trained_on_is_familiar(samples, small) -> None:
    data = TrainingSet.build(samples, small)
    net = train_network(data, np.arange(40), QUICK.replace(epochs=1))
    model = TouchModel(
        NetworkEstimator(small, fold(net), LengthRangeCheck.fit(data.lengths)), {"name": "toy", "sha256": ""}
    )
    predictions = [model.predict(sample.cloud, [sample.grasp])[0] for sample in samples]
    assert not any("unfamiliar" in prediction.flags for prediction in predictions)


def test_the_papers_recipe_runs(samples, small) -> None:
    config = small.replace(outputs=("E_TH",), metric_inputs=False, channels="xyz+normals")
    data = TrainingSet.build(samples, config)
    recipe = TrainConfig(
        epochs=2,
        batch_size=32,
        optimiser="adam",
        learning_rate=0.01,
        weight_decay=0.0,
        schedule="constant",
        loss="rmse",
        target_scaling="ranges",
    )
    net = train_network(data, np.arange(60), recipe)
    assert_allclose(net.target_mean.numpy(), 100.0)
    assert_allclose(net.target_scale.numpy(), 3500.0)
    assert np.isfinite(predict_set(net, data, np.arange(3))).all()


def test_the_last_smaller_batch_is_used_if_asked_for(samples, small) -> None:
    data = TrainingSet.build(samples, small)
    for partial, sizes in ((False, [16, 16, 16]), (True, [16, 16, 16, 2])):
        config = TrainConfig(epochs=1, batch_size=16, partial_batches=partial, root_epsilon=1e-6, loss="rmse")
        trainer = SupervisedTrainer(data, np.arange(50), config)
        assert [len(batch) for batch, *_ in trainer.batches()] == sizes
        assert trainer.batch_count == len(sizes)
        assert np.isfinite(trainer.run_epoch()["loss"])


def test_every_modality_counts_alike() -> None:
    scaled = torch.zeros(4, 50)
    for column in (0, slice(2, 26)):
        target = torch.zeros(4, 50)
        target[:, column] = 2.0
        assert float(labeled_loss(scaled, target, SIZES, "mse")) == pytest.approx(1.0)  # 2² over four modalities
        assert float(labeled_loss(scaled, target, SIZES, "rmse")) == pytest.approx(0.5, abs=1e-5)
        # One modality at sqrt(4 + 5), three at sqrt(5).
        rooted = (3.0 + 3.0 * 5.0**0.5) / 4.0
        assert float(labeled_loss(scaled, target, SIZES, "rmse", epsilon=5.0)) == pytest.approx(rooted, abs=1e-5)


def test_bad_samples_are_named(samples, small) -> None:
    with pytest.raises(DatasetError, match="no sample"):
        TrainingSet.build([], small)
    with pytest.raises(DatasetError, match=f"{samples[0].id}: touch: is not labelled"):
        TrainingSet.build([dataclasses.replace(samples[0], touch=None)], small)
    dead = dataclasses.replace(samples[1].touch, pdc_mf=-22072.0)
    with pytest.raises(DatasetError, match=f"{samples[1].id}: touch: pdc_mf: -22072"):
        TrainingSet.build([dataclasses.replace(samples[1], touch=dead)], small)


def test_too_few_samples_and_divergence_are_named(samples, small) -> None:
    data = TrainingSet.build(samples, small)
    with pytest.raises(DatasetError, match="3 samples are fewer than one batch of 8"):
        train_network(data, np.arange(3), QUICK)
    with pytest.raises(DatasetError, match="the loss is not finite in epoch"):
        train_network(data, np.arange(40), QUICK.replace(optimiser="sgd", learning_rate=10.0, schedule="constant"))


def test_duplicate_labels_are_found(samples) -> None:
    copy = dataclasses.replace(samples[3], id="x/1", touch=samples[7].touch)
    assert duplicate_labels(samples) == []
    assert duplicate_labels([*samples, copy]) == [(samples[7].id, "x/1")]


def test_cross_validation_scores_network_and_baselines_on_the_same_folds(samples, small) -> None:
    train = QUICK.replace(epochs=40).to_mapping()
    config = RunConfig.from_mapping({"model": small.to_mapping(), "train": train, "calibrate": True})
    learner = make_learner(config, Dataset("boxes", tuple(samples), "sha", {}))
    quick = {"training_mean": training_mean, "object_mean": object_mean}
    folds = make_folds(samples, "random", 0)
    scores, predicted = cross_validate(
        samples, labels_of(samples), learner.predict_fold, folds, learner.config.ranges, baselines=quick
    )
    assert set(scores) == {"model", "training_mean", "object_mean"}
    assert_allclose([one.skill for one in scores["training_mean"].values()], 0.0, atol=1e-12)
    assert scores["model"]["E_TH"].skill > 0.2
    assert_allclose(predicted[folds[2].test], learner.predict_fold(folds[2]))
    with pytest.raises(DatasetError, match="'blocks' is none of random, time, object"):
        make_folds(samples, "blocks", 0)
