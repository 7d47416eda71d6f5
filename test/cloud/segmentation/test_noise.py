# SPDX-License-Identifier: Apache-2.0
"""The noise of the depth in small windows: against least squares, a known noise, and tables with boards, levels and waves."""

import numpy as np
import pytest
from cloud.segmentation.test_background import WIDTH, labelled, room

from foretouch.cloud.segmentation.clusters import CoarseGrid, CropConfig, local_noise
from foretouch.cloud.segmentation.segment import segment
from foretouch.types import Cloud

NOISE = 0.002  # of the depth, by its square [1/m]
BOARD = ((-0.28, -0.2, 0.0), (0.28, 0.2, 0.007))
LEVEL = ((-0.45, 0.05, 0.0), (0.45, 0.35, 0.009))
TALL, LOW = ((-0.07, -0.02, 0.0), (0.0, 0.06, 0.08)), ((0.0, -0.05, 0.0), (0.07, 0.03, 0.05))  # side by side


def measured(cloud: Cloud) -> float:
    """The noise of every second pixel."""
    return local_noise(CoarseGrid(np.ascontiguousarray(cloud.xyz[::2, ::2]), 2, 0.0), CropConfig())


def wavy(cloud: Cloud) -> Cloud:
    """The cloud with waves of 6 mm along the ray, 160 pixels long."""
    wave = 0.006 * np.sin(np.arange(WIDTH) / 25.0) / cloud.xyz[..., 2]
    return Cloud((cloud.xyz * (1.0 + wave[..., None])).astype(np.float32))


def raised(box: tuple[tuple[float, ...], tuple[float, ...]], by_m: float) -> tuple[tuple[float, ...], ...]:
    return tuple((x, y, z + by_m) for x, y, z in box)


def test_it_is_the_lower_quartile_of_what_least_squares_leave_in_windows_in_range() -> None:
    xyz = room(noise_m=NOISE)[0].xyz[::2, ::2].copy()
    xyz[40:44, 60:90] = np.nan
    xyz[:10, :40] *= 4.0  # out of range
    z = xyz[..., 2].astype(np.float64)
    ones = np.stack([np.ones(25), *(axis.ravel() for axis in np.indices((5, 5)))], axis=1)
    residuals = []
    for i in range(0, z.shape[0] - 4, 6):
        for j in range(0, z.shape[1] - 4, 6):
            window = z[i : i + 5, j : j + 5].ravel()
            if ((window >= 0.16) & (window <= 2.0)).all():
                rest = np.linalg.lstsq(ones, 1.0 / window, rcond=None)[1]
                residuals.append(np.sqrt(rest[0] / 22.0))
    expected = np.sort(residuals)[len(residuals) // 4]
    assert local_noise(CoarseGrid(np.ascontiguousarray(xyz), 2, 0.0), CropConfig()) == pytest.approx(expected, rel=1e-6)
    assert local_noise(CoarseGrid(np.full((20, 20, 3), np.nan, np.float32), 2, 0.0), CropConfig()) == 0.0


def test_it_is_that_of_the_camera_whatever_the_table_is_like() -> None:
    for noise in (NOISE, 2.0 * NOISE):
        for cloud in (room()[0], room(BOARD)[0], room(LEVEL)[0], wavy(room()[0])):
            flat = cloud.xyz / cloud.xyz[..., 2:]  # the rays
            z = cloud.xyz[..., 2] + np.random.default_rng(0).normal(0.0, noise, flat.shape[:2]) * cloud.xyz[..., 2] ** 2
            assert 0.7 * noise < measured(Cloud((flat * z[..., None]).astype(np.float32))) < 1.2 * noise


@pytest.mark.parametrize("tilt", [20.0, 40.0])
def test_two_boxes_side_by_side_are_two_on_a_board_beside_a_level_and_on_waves(tilt: float) -> None:
    rooms = {
        "table": (TALL, LOW),
        "board": (raised(TALL, 0.007), raised(LOW, 0.007), BOARD),
        "level": (TALL, LOW, ((-0.45, 0.08, 0.0), (0.45, 0.35, 0.009))),
    }
    found = {name: labelled(segment(cloud), labels) for name, boxes in rooms.items() for cloud, labels in [room(*boxes, tilt_deg=tilt, distance_m=0.7)]}  # fmt: skip
    cloud, labels = room(TALL, LOW, tilt_deg=tilt, distance_m=0.7)
    found["waves"] = labelled(segment(wavy(cloud)), labels)
    assert set(map(tuple, found.values())) == {(3, 4)}, found
