# SPDX-License-Identifier: Apache-2.0
from collections.abc import Callable

import numpy as np
import pytest
from every_case import every_case

from foretouch.errors import CloudError, GraspError, TactileError
from foretouch.tactile import biotac_touch
from foretouch.types import Cloud, Grasp, Plane


def test_what_breaks_a_rule_is_refused() -> None:
    def check(message: str, error: type[Exception], make: Callable[[], object]) -> None:
        with pytest.raises(error, match=message):
            make()

    zeros, eye = np.zeros, np.eye(3)
    cases = [
        ("dtype bool is not of numbers", CloudError, lambda: Cloud(zeros((4, 3), np.bool_))),
        ("dtype <U1 is not of numbers", CloudError, lambda: Cloud(np.full((4, 3), "1"))),
        ("dtype complex128 is not of numbers", CloudError, lambda: Cloud(zeros((4, 3), complex))),
        *(("neither", CloudError, lambda s=s: Cloud(zeros(s, np.float32))) for s in ((3,), (4, 2), (2, 2, 2, 3))),
        ("differs from xyz", CloudError, lambda: Cloud(zeros((4, 3), np.float32), zeros((5, 3), np.uint8))),
        ("int64 is not uint8", CloudError, lambda: Cloud(zeros((4, 3), np.float32), zeros((4, 3), np.int64))),
        ("zero length", CloudError, lambda: Plane.from_coefficients([0, 0, 0, 1])),
        ("not four finite numbers", CloudError, lambda: Plane.from_coefficients([0, 0, np.nan, 1])),
        ("plane: ", CloudError, lambda: Plane.from_coefficients([0, 0, 1, np.inf])),
        ("offset of .* is not finite", CloudError, lambda: Plane.from_coefficients([0.0, 0.0, 1e-10, 1e300])),
        (r"g2: .* is not finite", GraspError, lambda: Grasp(zeros(3), np.array([np.inf, 0, 0]), eye)),
        ("both contacts", GraspError, lambda: Grasp(np.ones(3), np.ones(3), eye)),
        (r"g1: shape \(2,\)", GraspError, lambda: Grasp(zeros(2), np.ones(3), eye)),
        (r"touch: shape \(49,\)", TactileError, lambda: biotac_touch(zeros(49))),
    ]
    every_case(cases, check)


def test_any_numbers_become_float32() -> None:
    points = [[0.1, 0.2, 0.3], [1.0, np.nan, 1e300]]
    for xyz in (np.array(points), np.array(points, ">f8"), np.array(points, np.longdouble), points):
        cloud = Cloud(xyz)
        assert cloud.xyz.dtype == np.float32
        np.testing.assert_array_equal(cloud.xyz, np.array([[0.1, 0.2, 0.3], [1.0, np.nan, np.inf]], np.float32))
    assert Cloud(np.ones((4, 3), np.int16)).xyz.dtype == np.float32
    single = np.zeros((4, 3), np.float32)
    assert Cloud(single).xyz is single  # no copy


def test_take_by_mask_equals_take_by_index(rng: np.random.Generator) -> None:
    xyz = rng.normal(size=(6, 5, 3)).astype(np.float32)
    rgb = rng.integers(0, 255, (6, 5, 3), dtype=np.uint8)
    cloud = Cloud(xyz, rgb, "camera", 7)
    mask = xyz[..., 0] > 0
    by_mask, by_index = cloud.take(mask), cloud.take(np.flatnonzero(mask))
    np.testing.assert_array_equal(by_mask.xyz, xyz[mask])
    np.testing.assert_array_equal(by_mask.xyz, by_index.xyz)
    np.testing.assert_array_equal(by_mask.rgb, rgb[mask])
    assert (by_mask.frame_id, by_mask.stamp_ns) == ("camera", 7)


def test_a_normalised_plane_the_middle_and_width_of_a_grasp_and_the_vector_of_a_touch() -> None:
    plane = Plane.from_coefficients([0, 0, 2, -2.5])
    np.testing.assert_allclose(plane.coefficients, [0, 0, 1, -1.25])
    np.testing.assert_allclose(plane.height(np.array([[5.0, 6.0, 1.5]])), [0.25])

    for scale in (5e-324, 1e-310, 1e-161, 1e-155, 1e155, 1e200, 3e307):
        plane = Plane.from_coefficients(np.array([1.0, -2.0, 2.0, 3.0]) * scale)
        np.testing.assert_allclose(plane.coefficients, np.array([1.0, -2.0, 2.0, 3.0]) / 3.0, rtol=1e-13)
    grasp = Grasp(np.array([0.0, 0.0, 1.0]), np.array([0.03, 0.04, 1.0]), np.eye(3))
    np.testing.assert_allclose(grasp.midpoint, [0.015, 0.02, 1.0])
    assert grasp.width_m == pytest.approx(0.05)
    vector = np.arange(50.0)
    touch = biotac_touch(vector)
    assert (touch["PDC_TH"][0], touch["PDC_MF"][0]) == (0.0, 1.0)
    assert (touch["E_TH"][0], touch["E_MF"][0], touch["E_MF"][-1]) == (2.0, 26.0, 49.0)
    np.testing.assert_array_equal(touch.values, vector)
