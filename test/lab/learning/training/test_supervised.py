# SPDX-License-Identifier: Apache-2.0
"""Training: it learns, repeats, balances the modalities, and can express the papers' recipe."""

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose

from foretouch.cloud.geometry.sampling import UnitSphereFrame
from foretouch.errors import ConfigError
from foretouch.models.network.checkpoint import Network, NetworkPredictor
from foretouch.models.network.preparation import LengthRangeCheck, prepare_grasps
from foretouch.models.touch_model import TouchModel
from foretouch.types import Grasp
from foretouch_lab.learning.data.training_set import TrainingSet, predict_set
from foretouch_lab.learning.training.supervised import SupervisedTrainer, TrainConfig, turn, viewing_axis_rotations

QUICK = TrainConfig(epochs=60, batch_size=8, learning_rate=5e-3)


def test_it_learns_what_can_be_learned_and_beats_the_mean(samples, small) -> None:
    data = TrainingSet.build(samples, small)
    trainer = SupervisedTrainer(data, np.arange(45), QUICK)
    losses = [trainer.run_epoch()["loss"] for _ in range(60)]
    net = SupervisedTrainer(data, np.arange(45), QUICK).train()
    assert all(torch.equal(value, net.state_dict()[name]) for name, value in trainer.net.cpu().state_dict().items())
    assert losses[-1] < 0.3 * losses[0]
    predicted = predict_set(net, data, np.arange(45, 60))
    actual = data.labels[45:]
    assert np.mean((predicted - actual) ** 2) < 0.5 * np.mean((data.labels[:45].mean(axis=0) - actual) ** 2)


def test_validation_predicts_what_the_model_predicts(samples, small) -> None:
    """And what was trained on is familiar."""
    data = TrainingSet.build(samples, small)
    net = SupervisedTrainer(data, np.arange(40), QUICK.replace(epochs=2)).train()
    estimator = NetworkPredictor([Network(small, net.folded(), LengthRangeCheck.fit(data.lengths))])
    model = TouchModel(estimator, {"name": "toy", "sha256": ""})
    predictions = [model.predict(sample.cloud, [sample.grasp])[0] for sample in samples]
    assert_allclose(predictions[50].value.values, predict_set(net, data, np.array([50]))[0], atol=0.05)
    assert not any("unfamiliar" in prediction.flags for prediction in predictions)


def test_the_last_smaller_batch_is_used_if_asked_for(samples, small) -> None:
    data = TrainingSet.build(samples, small)
    for partial, sizes in ((False, [16, 16, 16]), (True, [16, 16, 16, 2])):
        config = TrainConfig(epochs=1, batch_size=16, partial_batches=partial, root_epsilon=1e-6, loss="rmse")
        trainer = SupervisedTrainer(data, np.arange(50), config)
        assert len(list(trainer._epoch())) == trainer.batch_count == len(sizes)
        assert np.isfinite(trainer.run_epoch()["loss"])


def test_turning_commutes_with_preparation(samples, small, rng) -> None:
    sample = samples[0]
    (rotation,) = viewing_axis_rotations(1, 180.0, rng)
    xyz, grasp = sample.cloud.xyz.astype(np.float64), sample.grasp
    turned = Grasp(rotation @ grasp.g1, rotation @ grasp.g2, rotation @ grasp.rotation)
    frame, other = UnitSphereFrame.fit(xyz), UnitSphereFrame.fit(xyz @ rotation.T)
    points, fed = turn(
        torch.from_numpy(frame.apply_points(xyz))[None],
        torch.from_numpy(prepare_grasps([grasp], frame, small)).double(),
        torch.from_numpy(rotation)[None],
        small,
    )
    assert_allclose(points[0].numpy(), other.apply_points(xyz @ rotation.T), atol=1e-12)
    assert_allclose(fed.numpy(), prepare_grasps([turned], other, small), atol=1e-6)


def test_a_gpu_that_is_not_there_is_refused_and_auto_does_without() -> None:
    if torch.cuda.is_available():
        pytest.skip("there is a GPU")
    assert TrainConfig().resolved_device == "cpu"
    with pytest.raises(ConfigError, match=r"device: cuda: torch finds no GPU; choose auto or cpu"):
        TrainConfig(device="cuda").resolved_device  # noqa: B018
