# SPDX-License-Identifier: Apache-2.0
"""Flying points are found, and clean clouds keep all of theirs, thin objects among them."""

import numpy as np
from every_case import every_case

from foretouch.cloud.geometry.flying import flying_mask
from foretouch.grasp import GeoGraspConfig
from foretouch.types import Float32

SHARE = GeoGraspConfig().flying_share
FOCAL_PX = 615.0  # of a D415 at 848x480
ROW, COLUMN = np.mgrid[-60.0:60.0, -80.0:80.0]  # of the part of its image that shows the object


def seen(depth: np.ndarray) -> Float32:
    """(N, 3) the points of a depth image (120, 160) [m], NaN where there is none."""
    xyz = np.stack([COLUMN / FOCAL_PX * depth, ROW / FOCAL_PX * depth, depth], axis=-1)
    return xyz[np.isfinite(depth)].astype(np.float32)


def thin_objects() -> dict[str, Float32]:
    """Alone, and 40 mm before another part of the same object."""
    x, y = 1.2 / FOCAL_PX * COLUMN, 1.2 / FOCAL_PX * ROW  # [m] at a depth of 1.2 m
    turned, radius = 0.8 * x + 0.6 * y, np.hypot(x, y)
    shapes = {
        "wire along a row": np.abs(ROW) < 0.5,
        "diagonal wire": (np.abs(ROW - COLUMN) < 0.5) & (np.abs(COLUMN) < 50.0),
        "oblique wire": (np.abs(ROW - np.rint(0.4 * COLUMN)) < 0.5) & (np.abs(COLUMN) < 60.0),
        "pen": (np.abs(turned) < 0.004) & (radius < 0.07),
        "ring of wire": np.abs(radius - 0.05) < 0.002,
        "fork": (np.abs(x) < 0.015) & (np.abs(y) < 0.06) & ((y > 0.0) | (np.rint(x / 0.005) % 2 == 0)),
        "grid of wires": ((ROW % 12 == 0) | (COLUMN % 12 == 0)) & (radius < 0.09),
    }
    found = {name: seen(np.where(shape, 1.2, np.nan)) for name, shape in shapes.items()}
    behind = np.where(np.maximum(np.abs(x), np.abs(y)) < 0.08, 1.24, np.nan)
    found |= {f"{name} before a plate": seen(np.where(shape, 1.2, behind)) for name, shape in shapes.items()}
    steep = np.where((np.abs(x) < 0.002) & (np.abs(y) < 0.1), 1.2 + 2.0 * y, np.nan)
    cone = np.where(radius < 0.03, 1.2 + 3.5 * radius, np.nan)
    return found | {"rod towards the camera": seen(steep), "cone": seen(cone)}


def test_thin_objects_keep_every_point(rng) -> None:
    def check(xyz: Float32) -> None:
        alone = int(np.count_nonzero(flying_mask(xyz, 0.0)))
        assert alone == 0, f"{alone} of {len(xyz)}"
        noisy = (xyz * (1.0 + rng.normal(0.0, 0.0008, (len(xyz), 1)))).astype(np.float32)  # 1 mm of depth
        assert not flying_mask(noisy, SHARE).any()

    every_case(thin_objects(), check)
