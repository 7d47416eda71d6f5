# SPDX-License-Identifier: Apache-2.0
"""Small objects seen from above."""

import numpy as np
import pytest

from foretouch.types import Cloud, Plane


@pytest.fixture(scope="session")
def top_view() -> Plane:
    return Plane.from_coefficients([0.0, 0.0, 1.0, -1.27])


@pytest.fixture
def box_cloud() -> Cloud:
    """The top of a rounded box, 120 x 60 mm, with 0.5 mm of noise, as a camera at 1.2 m sees it."""
    rng = np.random.default_rng(1)
    along, across = np.meshgrid(np.arange(-0.06, 0.06, 0.002), np.arange(-0.03, 0.03, 0.002))
    depth = 1.2 + 30.0 * across**2 + rng.normal(0.0, 0.0005, along.shape)
    xyz = np.stack([across, along, depth], axis=-1).reshape(-1, 3)
    return Cloud(xyz.astype(np.float32))
