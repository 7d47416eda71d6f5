# SPDX-License-Identifier: Apache-2.0
"""What no camera sees and no hand holds is refused by name."""

from itertools import product

import numpy as np
import pytest
from every_case import every_case, every_refusal

from foretouch.cloud.geometry.limits import ObjectLimits, check_object, check_table
from foretouch.errors import CloudError, ConfigError
from foretouch.types import Plane


def _ball(radius_m: float, distance_m: float) -> np.ndarray:
    rng = np.random.default_rng(0)
    points = rng.normal(size=(500, 3))
    points *= radius_m / np.linalg.norm(points, axis=1, keepdims=True)
    return (points + np.array([0.0, 0.0, distance_m])).astype(np.float32)


def test_objects_out_of_the_limits_are_named() -> None:
    cases = [
        ("100 m away, more than max_range_m 10", 0.04, 100.0),
        ("away, more than max_range_m 10", 0.04, 1e30),
        ("m away, less than min_range_m 0.16", 0.04, 0.1),
        ("e-09 m, less than min_extent_m 0.005", 1e-9, 1e-6),
        ("less than min_extent_m 0.005", 1e-42, 1e-41),
        ("m, more than max_extent_m 0.6", 5.0, 6.0),
    ]
    every_refusal(CloudError, cases, lambda radius_m, distance_m: check_object(_ball(radius_m, distance_m)))


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


def test_tables_that_no_camera_sees_are_named() -> None:
    def check(*coefficients: float) -> None:
        check_table(Plane.from_coefficients(coefficients))

    cases = [
        ("plane: .*behind the camera", 0.0, 0.0, 1.0, 1.27),
        ("plane: .*behind the camera", 0.0, 0.0, -1.0, -1.27),
        ("plane: .*behind the camera", 0.1, 0.1, 1.0, 0.5),
        (r"plane: is 1e\+09 m away, more than max_range_m 10", 0.0, 0.0, 1.0, -1e9),
    ]
    every_refusal(CloudError, cases, check)
    seen = [(0, 0, 1, -1.27), (0, 0, -1, 1.27), (0, 1, 0, 0), (1, 0, 0, 0), (0, -1, 0, 0.4), (0, 1, 0, 0.4)]
    every_case([*seen, (0, -0.9, -0.4, 1.2)], check)
