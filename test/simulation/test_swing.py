# SPDX-License-Identifier: Apache-2.0
"""A period of motion begins where it ended and moves one object only."""

from __future__ import annotations

import numpy as np

from foretouch.simulation import random_scene
from foretouch.simulation.scene_camera import swinging


def _column(labels: np.ndarray, label: int) -> float:
    return float(np.argwhere(labels == label)[:, 1].mean())


def test_the_first_object_swings_and_the_others_rest() -> None:
    scene = random_scene(np.random.default_rng(0), 212, 120, 2)
    images = swinging(scene, 8)
    columns = [_column(image.labels, 2) for image in images]
    assert np.argmax(columns) == 2  # a quarter of the period
    assert np.argmin(columns) == 6
    assert abs(columns[0] - columns[4]) < 0.2
    assert len({_column(image.labels, 3) for image in images}) == 1


def test_an_empty_table_and_noise() -> None:
    scene = random_scene(np.random.default_rng(0), 212, 120, 0)
    one, other = swinging(scene, 2)
    assert np.array_equal(one.depth_mm, other.depth_mm)
    one, other = swinging(scene, 2, rng=np.random.default_rng(1), noise_m=0.002)
    assert not np.array_equal(one.depth_mm, other.depth_mm)
