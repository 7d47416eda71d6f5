# SPDX-License-Identifier: Apache-2.0
"""A small made-up dataset whose labels follow from what a network is fed."""

from pathlib import Path

import numpy as np
import pytest
import torch
from run_builders import write_store

from foretouch.models.network.config import ModelConfig
from foretouch.tactile import biotac_touch
from foretouch.types import Cloud, Grasp, Sample
from foretouch_lab.learning.data import Dataset, load_dataset

torch.set_num_threads(1)  # networks this small only lose time to more

SMALL = ModelConfig(n_points=48, tnet=False, trunk_widths=(16, 32), head_widths=(32, 16), metric_inputs=True)


def make_sample(rng: np.random.Generator, name: str, number: int) -> Sample:
    """A box whose height sets PDC_TH, grasped at a position that sets the electrodes."""
    size = rng.uniform(0.03, 0.09, 3)
    xyz = rng.uniform(-0.5, 0.5, (120, 3)) * size + [0.0, 0.0, 1.2]
    along = rng.uniform(-0.4, 0.4) * size[1]
    grasp = Grasp(np.array([size[0] / 2, along, 1.2]), np.array([-size[0] / 2, along, 1.2]), np.eye(3)[:, [1, 2, 0]])
    touch = biotac_touch(
        np.hstack(
            [
                2800.0 + 4000.0 * (size[2] - 0.06) + rng.normal(0.0, 1.0),
                1800.0 + 2000.0 * along + rng.normal(0.0, 1.0),
                3000.0 + np.linspace(1000, 5000, 24) * along + rng.normal(0.0, 4.0, 24),
                3200.0 - np.linspace(1000, 5000, 24) * (size[0] - 0.06) + rng.normal(0.0, 4.0, 24),
            ]
        )
    )
    stamp = (1_562_000_000 + 60 * number) * 1_000_000_000
    return Sample(f"{name}/{number}", name, Cloud(xyz.astype(np.float32)), grasp, touch, stamp_ns=stamp)


@pytest.fixture(scope="session")
def samples() -> list[Sample]:
    """60 samples of 4 objects, in no order of time."""
    rng = np.random.default_rng(7)
    made = [make_sample(rng, f"box{k % 4}", k) for k in range(60)]
    return [made[i] for i in rng.permutation(60)]


@pytest.fixture
def small() -> ModelConfig:
    """A network that trains within a second."""
    return SMALL


@pytest.fixture(scope="session")
def store(samples, tmp_path_factory) -> Path:
    return write_store(tmp_path_factory.mktemp("data") / "boxes", samples)


@pytest.fixture(scope="session")
def data(store) -> Dataset:
    return load_dataset(store)
