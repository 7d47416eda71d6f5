# SPDX-License-Identifier: Apache-2.0
"""What a camera sees and a hand holds is accepted; what is refused stands in test/corpus/clouds.py."""

from itertools import product

import numpy as np
import pytest
from every_case import every_case

from foretouch.cloud.geometry.limits import ObjectLimits, check_object, check_table
from foretouch.errors import ConfigError, FrameError
from foretouch.grasp import GeoGraspConfig, plan_grasps
from foretouch.types import Cloud, Plane, assumed_table


def _ball(radius_m: float, distance_m: float) -> np.ndarray:
    rng = np.random.default_rng(0)
    points = rng.normal(size=(500, 3))
    points *= radius_m / np.linalg.norm(points, axis=1, keepdims=True)
    return (points + np.array([0.0, 0.0, distance_m])).astype(np.float32)


def test_objects_within_the_limits_which_are_settings_and_tables_that_a_camera_sees_are_accepted() -> None:
    def check(radius_m: float, distance_m: float) -> None:
        xyz = _ball(radius_m, distance_m)
        xyz[::7] = np.nan
        check_object(xyz)
        check_object(xyz.reshape(100, 5, 3))

    every_case(product([0.003, 0.04, 0.29], [0.2, 1.2, 9.9]), check)
    check_object(_ball(1.0, 50.0), ObjectLimits(max_range_m=60.0, max_extent_m=3.0))
    with pytest.raises(ConfigError, match=r"min_extent_m: 0\.7 is not below"):
        ObjectLimits(min_extent_m=0.7)
    seen = [(0, 0, 1, -1.27), (0, 0, -1, 1.27), (0, 1, 0, 0), (1, 0, 0, 0), (0, -1, 0, 0.4), (0, 1, 0, 0.4)]
    every_case([*seen, (0, -0.9, -0.4, 1.2)], lambda *plane: check_table(Plane.from_coefficients(plane)))


def test_an_object_that_its_table_cannot_carry_gets_no_grasp() -> None:
    xyz = _ball(0.04, 1.2)
    for offset in (-1.19, -1.24, -1.5):  # through it, under it, and what lies on something else
        check_table(Plane.from_coefficients((0, 0, 1, offset)), xyz=xyz)
    check_table(Plane.from_coefficients((0, 0, 1, -1.0)), ObjectLimits(min_range_m=0.0), xyz)
    for offset, words in ((-1.1, "0.06 m below"), (-5.0, "3.76 m above")):
        for sign in (1, -1):
            plan = plan_grasps(Cloud(xyz), Plane.from_coefficients((0, 0, sign, sign * offset)), GeoGraspConfig())
            assert (plan.status, len(plan.grasps)) == ("no_grasp", 0)
            assert plan.reason == f"plane: all of the object is {words} it; is it the table, in the frame of the cloud?"


TO_BASE = np.array([[0, 0, 1], [-1, 0, 0], [0, -1, 0]], np.float32)  # x forward, y left, z up
FRAMES = {  # a ball at 0.6 m, as others store it
    "link of a camera": (TO_BASE, "but in view along x, as in the frame of a link"),
    "OpenGL": (np.diag([1.0, -1.0, -1.0]), "100% of the points are at z <= 0, behind the camera"),
    "beside a robot": (np.array([[1, 0, 0], [0, 0, 1], [0, 0, 0.1]]), "100% of the points are out of view along z:"),
}


@pytest.mark.parametrize("name", FRAMES)
def test_an_object_in_another_frame_is_refused_by_every_function_that_takes_one(name: str) -> None:
    turn, rule = FRAMES[name]
    xyz = (_ball(0.04, 0.6) @ turn.T.astype(np.float32)).astype(np.float32)
    with pytest.raises(FrameError, match=f"not_optical: .*{rule}.*transform the points"):
        check_object(xyz)
    check_object(xyz, ObjectLimits(min_range_m=0.0))  # in the object's own frame there is no camera
    for method in ("completed", "original"):
        plan = plan_grasps(Cloud(xyz), assumed_table(Cloud(xyz)), GeoGraspConfig(method=method))
        assert (plan.status, len(plan.grasps), plan.reason[:12]) == ("unknown_frame", 0, "not_optical:")
