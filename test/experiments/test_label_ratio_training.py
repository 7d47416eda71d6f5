# SPDX-License-Identifier: Apache-2.0
"""The two trainers of `label_ratio`."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from every_case import every_case

from foretouch.experiments.label_ratio.training import PointnetTrainer, PresampledSet, configured
from foretouch.learning.training.srgan import SrganConfig, SrganTrainer
from foretouch.models.network.config import ModelConfig
from foretouch.models.network.networks import GeneratorConfig

POINTS = 16
MODEL = ModelConfig(n_points=POINTS, tnet=False, trunk_widths=(16, 32), head_widths=(16,), outputs=("PDC_TH",))
BASE = SrganConfig(
    batch_size=8, target_scaling="standardised", generator=GeneratorConfig(noise_length=1, widths=(4,), stride=4)
)


@pytest.fixture
def presampled() -> PresampledSet:
    rng = np.random.default_rng(0)
    clouds = rng.uniform(-1.0, 1.0, (24, POINTS, 3)).astype(np.float32)
    return PresampledSet(
        clouds=tuple(clouds),
        cached_points=clouds,
        grasps=rng.normal(size=(24, 15)).astype(np.float32),
        labels=rng.normal(2000.0, 100.0, (24, 50)),
        lengths=np.zeros((24, 0)),
        config=MODEL,
        ids=tuple(f"box/{k}" for k in range(24)),
    )


def test_the_pointnet_is_the_srgan_without_unsupervised_weights(presampled: PresampledSet) -> None:
    """One batch of all points of all labelled samples, so that neither order nor choice makes a difference."""
    config = configured(BASE, "pointnet", "rate 0.003", 8, updates=5, seed=1)
    assert config.loss.weight_unlabeled == config.loss.weight_fake == config.loss.gradient_penalty == 0.0
    nets = []
    for kind in (PointnetTrainer, SrganTrainer):
        trainer = kind(presampled, np.arange(8), np.arange(8, 24), config)
        while trainer.epoch < trainer.epochs:
            trainer.run_epoch()
        assert trainer.epoch == 5
        nets.append(trainer.net)
    for one, other in zip(nets[0].parameters(), nets[1].parameters(), strict=True):
        torch.testing.assert_close(one, other, rtol=1e-3, atol=1e-5)
    nets = [  # and the SR-GAN of a trial begins with the same network
        kind(presampled, np.arange(8), np.arange(8, 24), configured(BASE, model, trial, 8, updates=1, seed=4)).net
        for kind, model, trial in ((PointnetTrainer, "pointnet", "rate 0.003"), (SrganTrainer, "srgan", "0.3/1/1"))
    ]
    for one, other in zip(nets[0].state_dict().values(), nets[1].state_dict().values(), strict=True):
        assert torch.equal(one, other)


def test_epochs_follow_from_updates() -> None:
    def check(labelled: int, updates: int | None, epochs: int) -> None:
        assert configured(BASE, "srgan", "0.3/1/1", labelled, updates, seed=0).epochs == epochs

    every_case([(320, 640, 16), (2880, 640, 2), (64, 1, 1), (64, None, 30)], check)


def test_points_are_those_of_the_cloud_each_once(presampled: PresampledSet) -> None:
    long = replace(presampled, cached_points=np.arange(2 * 40 * 3, dtype=np.float32).reshape(2, 40, 3))
    rng = np.random.default_rng(0)
    drawn = [long.points(np.array([1, 0, 1]), rng, 30) for _ in range(3)]
    for cloud, index in zip(np.concatenate(drawn), [1, 0, 1] * 3, strict=True):
        rows = {tuple(row) for row in cloud}
        assert len(rows) == 30
        assert rows <= {tuple(row) for row in long.cached_points[index]}
    assert not np.array_equal(drawn[0], drawn[1])
