# SPDX-License-Identifier: Apache-2.0
"""What no camera sees and no hand holds is refused by name; every recorded object is accepted."""

from pathlib import Path

import numpy as np
import pytest

from foretouch.cloud.geometry.limits import ObjectLimits, check_object, check_table
from foretouch.errors import CloudError, ConfigError
from foretouch.types import Plane


def _ball(radius_m: float, distance_m: float) -> np.ndarray:
    rng = np.random.default_rng(0)
    points = rng.normal(size=(500, 3))
    points *= radius_m / np.linalg.norm(points, axis=1, keepdims=True)
    return (points + np.array([0.0, 0.0, distance_m])).astype(np.float32)


@pytest.mark.parametrize(
    ("radius_m", "distance_m", "reason"),
    [
        (0.04, 100.0, "100 m away, more than max_range_m 10"),
        (0.04, 1e30, "away, more than max_range_m 10"),
        (0.04, 0.1, "m away, less than min_range_m 0.16"),
        (1e-9, 1e-6, "e-09 m, less than min_extent_m 0.005"),
        (1e-42, 1e-41, "less than min_extent_m 0.005"),
        (5.0, 6.0, "m, more than max_extent_m 0.6"),
    ],
)
def test_objects_out_of_the_limits_are_named(radius_m: float, distance_m: float, reason: str) -> None:
    with pytest.raises(CloudError, match=reason):
        check_object(_ball(radius_m, distance_m))


@pytest.mark.parametrize("distance_m", [0.2, 1.2, 9.9])
@pytest.mark.parametrize("radius_m", [0.003, 0.04, 0.29])
def test_objects_within_the_limits_are_accepted(radius_m: float, distance_m: float) -> None:
    xyz = _ball(radius_m, distance_m)
    xyz[::7] = np.nan
    check_object(xyz)
    check_object(xyz.reshape(100, 5, 3))


def test_the_limits_are_settings() -> None:
    check_object(_ball(1.0, 50.0), ObjectLimits(max_range_m=60.0, max_extent_m=3.0))
    with pytest.raises(ConfigError, match=r"min_extent_m: 0\.7 is not below"):
        ObjectLimits(min_extent_m=0.7)


@pytest.mark.parametrize(
    ("coefficients", "reason"),
    [
        ((0.0, 0.0, 1.0, 1.27), "behind the camera"),
        ((0.0, 0.0, -1.0, -1.27), "behind the camera"),
        ((0.1, 0.1, 1.0, 0.5), "behind the camera"),
        ((0.0, 0.0, 1.0, -1e9), r"1e\+09 m away, more than max_range_m 10"),
    ],
)
def test_tables_that_no_camera_sees_are_named(coefficients: tuple[float, ...], reason: str) -> None:
    with pytest.raises(CloudError, match=f"plane: .*{reason}"):
        check_table(Plane.from_coefficients(coefficients))


@pytest.mark.parametrize(
    "coefficients",
    [
        (0, 0, 1, -1.27),
        (0, 0, -1, 1.27),
        (0, 1, 0, 0),
        (1, 0, 0, 0),
        (0, -1, 0, 0.4),
        (0, 1, 0, 0.4),
        (0, -0.9, -0.4, 1.2),
    ],
)
def test_tables_in_view_are_accepted(coefficients: tuple[float, ...]) -> None:
    check_table(Plane.from_coefficients(coefficients))


@pytest.mark.real_data
def test_every_recorded_object_is_accepted(real_data: Path) -> None:
    from foretouch.cloud.io.files import read_cloud

    paths = sorted(real_data.glob("vision2tactile/*/*/cloud-object.pcd"))
    assert len(paths) >= 400
    for path in paths:
        check_object(read_cloud(path).xyz)
