# SPDX-License-Identifier: Apache-2.0
"""Runs trained together against each of them alone."""

import dataclasses

import numpy as np
import pytest
import torch

from foretouch.errors import ConfigError, DatasetError
from foretouch.learning.data.training_set import TrainingSet
from foretouch.learning.training.supervised import TrainConfig, train_network
from foretouch.learning.training.trainer import OptimiserRule, ScheduledOptimiser
from foretouch.learning.training.vectorised import train_many

CONFIG = TrainConfig(epochs=3, batch_size=8, learning_rate=1e-3, optimiser="sgd", device="cpu")


@pytest.fixture
def sets(samples, small) -> list[TrainingSet]:
    """Two seeds of one modality and one of another, with batch norm in T-Net, trunk and head."""
    shape = small.replace(tnet=True, tnet_widths=(8, 8, 16, 8, 8), head_norm=True)
    made = [TrainingSet.build(samples, shape.replace(outputs=(name,))) for name in ("PDC_TH", "PDC_MF")]
    return [made[0], made[0], made[1]]


def apart(one: torch.nn.Module, two: torch.nn.Module) -> float:
    """Largest difference of a weight or a running statistic; they are of order one."""
    pairs = [(a, two.state_dict()[name]) for name, a in one.state_dict().items() if name != "target_mean"]
    return max(float((a.double() - b.double()).abs().max()) for a, b in pairs)


def test_each_run_is_what_it_is_alone(sets) -> None:
    configs = [CONFIG.replace(seed=seed) for seed in (0, 5, 0)]
    indices = [np.arange(40), np.arange(10, 50), np.arange(40)]
    together = train_many(sets, indices, configs)
    alone = [train_network(data, index, config) for data, index, config in zip(sets, indices, configs, strict=True)]
    for one, two in zip(together, alone, strict=True):
        assert not one.training
        assert apart(one, two) < 1e-5
    assert apart(together[0], together[1]) > 0.1


@pytest.mark.parametrize("optimiser", ["adam", "adamw", "sgd"])
def test_optimisers_work_value_by_value(optimiser: str) -> None:
    """So a stack moves as its members do. Not tested on networks: Adam takes full steps along a gradient that is rounding."""
    rule = OptimiserRule(optimiser, 0.1, 0.01, "cosine")
    stack = torch.nn.ParameterList([torch.linspace(-1.0, 1.0, 6).view(2, 3)])
    members = [torch.nn.ParameterList([part.detach().clone()]) for part in stack[0]]
    optimisers = [ScheduledOptimiser(module, rule, 4) for module in (stack, *members)]
    for _ in range(4):
        for one, module in zip(optimisers, (stack, *members), strict=True):
            one.step(module[0].pow(4).sum())
    torch.testing.assert_close(stack[0], torch.stack([member[0] for member in members]), rtol=1e-6, atol=1e-7)


def test_runs_of_several_shapes_are_refused(sets, samples, small) -> None:
    index = [np.arange(40)] * 2
    with pytest.raises(ConfigError, match="run 1: its TrainConfig differs"):
        train_many(sets[:2], index, [CONFIG, CONFIG.replace(epochs=4)])
    with pytest.raises(ConfigError, match="run 1: is of another shape"):
        train_many(sets[:2], [np.arange(40), np.arange(50)], [CONFIG] * 2)
    dropped = TrainingSet.build(samples, small.replace(head_dropout=0.1))
    with pytest.raises(ConfigError, match="head_dropout: must be 0"):
        train_many([dropped] * 2, index, [CONFIG] * 2)
    assert train_many([], [], []) == []


def test_the_run_that_diverges_is_named(sets) -> None:
    spoilt = dataclasses.replace(sets[1], labels=np.where(np.arange(60)[:, None] == 3, np.inf, sets[1].labels))
    with pytest.raises(DatasetError, match=r"run 1: the loss is not finite in epoch 0, batch \d"):
        train_many([sets[0], spoilt], [np.arange(40)] * 2, [CONFIG.replace(target_scaling="ranges")] * 2)
