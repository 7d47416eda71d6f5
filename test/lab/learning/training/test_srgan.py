# SPDX-License-Identifier: Apache-2.0
"""The SR-GAN: both networks move, labels are learned, batch mates do nothing, and it resumes bit for bit."""

import dataclasses

import numpy as np
import pytest
import torch

from foretouch_lab.learning.data.training_set import TrainingSet
from foretouch_lab.learning.network.networks import GeneratorConfig
from foretouch_lab.learning.network.pointnet import freeze
from foretouch_lab.learning.training.losses import SrganLossConfig
from foretouch_lab.learning.training.srgan import SrganConfig, SrganTrainer

GENERATOR = GeneratorConfig(noise_length=3, stride=2)  # 24 points
SRGAN = SrganLossConfig(loss_variant="srgan")
QUICK = SrganConfig(epochs=2, batch_size=5, learning_rate=1e-3, points=24, generator=GENERATOR, loss=SRGAN)
LABELLED, UNLABELLED = np.arange(20), np.arange(20, 60)


@pytest.fixture
def data(samples, small) -> TrainingSet:
    return TrainingSet.build(samples, small)


def make(data: TrainingSet, config: SrganConfig = QUICK) -> SrganTrainer:
    return SrganTrainer(data, LABELLED, UNLABELLED, config)


def weights(trainer) -> dict[str, torch.Tensor]:
    states = {name: module.state_dict() for name, module in trainer.modules.items()}
    return {f"{name}/{key}": value.clone() for name, state in states.items() for key, value in state.items()}


def equal(one: dict[str, torch.Tensor], two: dict[str, torch.Tensor]) -> bool:
    return one.keys() == two.keys() and all(torch.equal(one[key], two[key]) for key in one)


def steps(trainer: SrganTrainer, epochs: int) -> SrganTrainer:
    for _ in range(epochs):
        trainer.run_epoch()
    return trainer


def test_each_step_moves_its_own_network_alone_and_frozen_batch_mates_move_no_features(data) -> None:
    trainer = make(data)
    freeze(trainer.net)
    real = trainer._inputs(UNLABELLED[:5])[0]
    one = weights(trainer)
    trainer._generator_step(real)
    two = weights(trainer)
    assert all(torch.equal(one[key], two[key]) == key.startswith("net/") for key in one)
    trainer._regressor_step(LABELLED[:5], real)
    three = weights(trainer)
    assert all(torch.equal(two[key], three[key]) for key in two if key.startswith("generator/"))
    assert not torch.equal(two["net/output.weight"], three["net/output.weight"])
    trainer = steps(make(data), 1)
    points = trainer._inputs(LABELLED[:5])[0]
    other = points.clone()
    other[1:] *= 3.0
    with torch.no_grad():
        torch.testing.assert_close(trainer.net.features(other)[0], trainer.net.features(points)[0])
        trainer.net.train()
        assert (trainer.net.features(other)[0] - trainer.net.features(points)[0]).abs().max() > 0.01


def test_statistics_per_source_are_those_of_labelled_clouds_alone(data) -> None:
    config = QUICK.replace(batch_norm="per_source")
    one, two = make(data, config), make(data, config)
    strange = one._inputs(UNLABELLED[:5])[0] * 50.0
    for trainer, real in ((one, strange), (two, two._inputs(UNLABELLED[:5])[0])):
        trainer.net.train()
        trainer._regressor_step(LABELLED[:5], real)
    assert torch.equal(one.net.features.layers[0].norm.running_mean, two.net.features.layers[0].norm.running_mean)


def test_the_seed_decides_everything_and_unlabelled_labels_nothing(data, samples, small) -> None:
    torch.manual_seed(1)
    one = weights(steps(make(data), 2))
    state = torch.random.get_rng_state()
    torch.rand(5)
    two = weights(steps(make(data), 2))
    assert equal(one, two)
    torch.random.set_rng_state(state)
    assert not equal(one, weights(steps(make(data, QUICK.replace(seed=4)), 2)))
    bare = [sample if i < 20 else dataclasses.replace(sample, touch=None) for i, sample in enumerate(samples)]
    assert equal(two, weights(steps(make(TrainingSet.build(bare, small, unlabelled=True)), 2)))
