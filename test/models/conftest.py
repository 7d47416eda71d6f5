# SPDX-License-Identifier: Apache-2.0
"""Small networks, clouds and grasps that the tests of models share."""

from collections.abc import Callable

import numpy as np
import pytest
import torch

from foretouch.models.network.config import ModelConfig
from foretouch.types import Cloud, Grasp
from foretouch_lab.learning.network.networks import TouchNet

torch.set_num_threads(1)  # networks this small only lose time to more

SMALL = ModelConfig(n_points=64, trunk_widths=(8, 16, 32), tnet_widths=(8, 8, 16, 8, 8), head_widths=(16, 8))


@pytest.fixture
def small() -> ModelConfig:
    """P2's layout with few and narrow layers."""
    return SMALL


@pytest.fixture(
    params=[
        {},
        {"tnet": False},
        {"use_grasp": False, "head_norm": True},
        {"channels": "xyz+normals", "metric_inputs": True, "head_norm": True},
        {"outputs": ("PDC_MF",), "head_widths": ()},
        {"trunk_widths": (16,), "head_dropout": 0.5},
        {"trunk_relu": False},
    ],
    ids=str,
)
def variant(request: pytest.FixtureRequest) -> ModelConfig:
    """A small network with some changes."""
    return SMALL.replace(**request.param)


@pytest.fixture
def make_net() -> Callable[..., TouchNet]:
    """Builds a network whose batch norms have seen data and whose outputs are counts."""

    def make(config: ModelConfig = SMALL, seed: int = 0) -> TouchNet:
        torch.manual_seed(seed)
        net = TouchNet(config)
        net.set_scaling(torch.linspace(1700, 3300, config.output_size), torch.linspace(20, 300, config.output_size))
        net.train()
        for _ in range(5):
            points = torch.randn(6, config.n_points, config.channel_count) * 0.4
            net(points, torch.randn(6, config.grasp_size) if config.use_grasp else None)
        return net.eval()

    return make


@pytest.fixture
def can(rng: np.random.Generator) -> Cloud:
    """The upper half of a cylinder of 66 mm by 100 mm, 1.2 m away, with colours."""
    angle, along = rng.uniform(0, np.pi, 900), rng.uniform(-0.05, 0.05, 900)
    xyz = np.column_stack([0.033 * np.cos(angle), along, 1.2 - 0.033 * np.sin(angle)])
    return Cloud(xyz.astype(np.float32), rng.integers(0, 256, (900, 3), dtype=np.uint8), "camera", 5)


@pytest.fixture
def make_grasps(rng: np.random.Generator) -> Callable[[int], list[Grasp]]:
    """Grasps across the can at random heights."""

    def make(count: int) -> list[Grasp]:
        rotation = np.column_stack([[0.0, 0.0, 1.0], [0.0, -1.0, 0.0], [1.0, 0.0, 0.0]])
        ends = ((np.array([0.033, y, 1.2]), np.array([-0.033, y, 1.2])) for y in rng.uniform(-0.04, 0.04, count))
        return [Grasp(*contacts, rotation, id=str(k)) for k, contacts in enumerate(ends)]

    return make
