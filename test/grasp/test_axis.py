# SPDX-License-Identifier: Apache-2.0
import numpy as np
from every_case import every_case

from foretouch.grasp import GeoGraspConfig
from foretouch.grasp.axis import _side, find_axis
from foretouch.types import Plane

SIDE_VIEW = Plane.from_coefficients([0.0, 1.0, 0.0, 0.0])
CONFIG = GeoGraspConfig(method="original")


def _rod(direction, n=400):
    """Points around a line through (0, 0, 1)."""
    rng = np.random.default_rng(0)
    direction = np.asarray(direction, float) / np.linalg.norm(direction)
    points = np.array([0.0, 0.0, 1.0]) + rng.uniform(-0.1, 0.1, (n, 1)) * direction
    return (points + rng.normal(0.0, 0.005, (n, 3))).astype(np.float32)


def test_finds_the_long_direction_and_sides_across_it(top_view):
    def check(*direction):
        axis = find_axis(_rod(direction), top_view, CONFIG)
        assert abs(axis.direction @ direction) / np.linalg.norm(direction) > 0.99
        assert axis.ratio < 0.2
        np.testing.assert_allclose(axis.centroid, [0.0, 0.0, 1.0], atol=0.02)

    every_case([(1, 0.2, 0), (0.1, 1, 0.1), (0.3, 0.3, 1), (1, 1, 1)], check)
    top = [([0.9, 0.3, 0.3], 1), ([0.3, 0.9, 0.3], 0), ([0.1, 0.1, 0.99], 0)]
    side = [([0.95, 0.1, 0.3], 2), ([0.1, 0.99, 0.1], 0), ([0.2, 0.1, 0.97], 0)]
    for plane, cases in ((top_view, top), (SIDE_VIEW, side)):
        assert [_side(np.array(axis), plane) for axis, _ in cases] == [one for _, one in cases]


def test_sign_in_top_view_whatever_the_order_of_points_and_the_sign_of_the_planes_normal(top_view, rng):
    def check(direction, sign):
        for _ in range(5):
            xyz = rng.permutation(_rod(direction))
            assert np.sign(find_axis(xyz, top_view, CONFIG).direction @ direction) == sign

    cases = {
        "flat and along x: towards -x": ([1.0, 0.1, 0.0], -1),
        "flat and along y: towards +y": ([0.1, 1.0, 0.0], 1),
        "steep: towards the camera": ([0.4, 0.0, 0.9], -1),
    }
    every_case(cases, check)
    for direction in ([0.2, 1.0, 0.3], [1.0, 0.2, 0.3], [0.5, -0.3, 1.0]):
        xyz = _rod(direction)
        flipped = Plane(-SIDE_VIEW.normal, -SIDE_VIEW.offset)
        axes = [find_axis(xyz, plane, CONFIG).direction for plane in (SIDE_VIEW, flipped)]
        np.testing.assert_array_equal(*axes)
