# SPDX-License-Identifier: Apache-2.0
"""What a camera sees and a hand holds is accepted; what is refused stands in test/corpus/clouds.py."""

from itertools import product

import numpy as np
import pytest
from every_case import every_case

from foretouch.cloud.geometry.limits import ObjectLimits, check_object, check_table
from foretouch.errors import ConfigError
from foretouch.types import Plane


def _ball(radius_m: float, distance_m: float) -> np.ndarray:
    rng = np.random.default_rng(0)
    points = rng.normal(size=(500, 3))
    points *= radius_m / np.linalg.norm(points, axis=1, keepdims=True)
    return (points + np.array([0.0, 0.0, distance_m])).astype(np.float32)


def test_objects_within_the_limits_which_are_settings_are_accepted() -> None:
    def check(radius_m: float, distance_m: float) -> None:
        xyz = _ball(radius_m, distance_m)
        xyz[::7] = np.nan
        check_object(xyz)
        check_object(xyz.reshape(100, 5, 3))

    every_case(product([0.003, 0.04, 0.29], [0.2, 1.2, 9.9]), check)
    check_object(_ball(1.0, 50.0), ObjectLimits(max_range_m=60.0, max_extent_m=3.0))
    with pytest.raises(ConfigError, match=r"min_extent_m: 0\.7 is not below"):
        ObjectLimits(min_extent_m=0.7)


def test_tables_that_a_camera_sees_are_accepted() -> None:
    def check(*coefficients: float) -> None:
        check_table(Plane.from_coefficients(coefficients))

    seen = [(0, 0, 1, -1.27), (0, 0, -1, 1.27), (0, 1, 0, 0), (1, 0, 0, 0), (0, -1, 0, 0.4), (0, 1, 0, 0.4)]
    every_case([*seen, (0, -0.9, -0.4, 1.2)], check)
