# SPDX-License-Identifier: Apache-2.0
import copy
import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from every_case import every_case

from foretouch.dataset.samples import SampleSet
from foretouch.errors import CloudError, DatasetError, GraspError, TactileError
from foretouch.tactile import BIOTAC, biotac_touch
from foretouch.types import Cloud, Grasp, Grasps, Plane, Predictions

ONE = Grasps(np.zeros((1, 3)), np.ones((1, 3)))


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
        ("stamp_ns: 'x' is not a whole number", CloudError, lambda: Cloud(zeros((4, 3)), stamp_ns="x")),
        ("stamp_ns: 1.* is not a whole number", CloudError, lambda: Cloud(zeros((4, 3)), stamp_ns=10**400)),
        ("frame_id: None is not a text", CloudError, lambda: Cloud(zeros((4, 3)), frame_id=None)),
        ("xyz: .* a number is too large", CloudError, lambda: Cloud([[10**400, 0, 1]])),
        ("g1: .* a number is too large", GraspError, lambda: Grasp([10**400, 0, 1], np.ones(3), eye)),
        ("g1: .* complex numbers", GraspError, lambda: Grasp(zeros(3, complex), np.ones(3), eye)),
        ("rotation: .* complex numbers", GraspError, lambda: Grasps(zeros((1, 3)), np.ones((1, 3)), eye[None] * 1j)),
        ("g1: .* texts", GraspError, lambda: Grasps(np.array([["a"] * 3]), np.ones((1, 3)), eye[None])),
        ("plane: .* complex numbers", CloudError, lambda: Plane.from_coefficients([0, 0, 1j, 1])),
        ("touch: .* complex numbers", TactileError, lambda: biotac_touch(zeros(50) * 1j)),
        ("g2: -1 is one number; give an array of shape \\(2, 3\\)", GraspError, lambda: Grasps(zeros((2, 3)), -1)),
        ("rotation: 1.0 is one number", GraspError, lambda: Grasps(zeros((2, 3)), np.ones((2, 3)), 1.0)),
        ("g1: shape \\(\\) is not \\(K, 3\\)", GraspError, lambda: Grasps(0.0, np.ones((2, 3)))),
        ("lower: 5.0 is one number", TactileError, lambda: Predictions(zeros((1, 50)), ONE, BIOTAC, lower=5.0)),
        ("upper: 5 is one number", TactileError, lambda: Predictions(zeros((1, 50)), ONE, BIOTAC, upper=5)),
        ("path: day is not a path; foretouch.open", DatasetError, lambda: SampleSet("day", "store", 1, int, str)),
        ("read: list is not a function", DatasetError, lambda: SampleSet(Path("day"), "store", 1, [], str)),
        ("size: -1 is negative", DatasetError, lambda: SampleSet(Path("day"), "store", -1, int, str)),
    ]
    assert np.isnan(Predictions(zeros((1, 50)), ONE, BIOTAC, lower=np.nan).lower).all()
    assert Grasps(zeros((2, 3)), np.ones((2, 3)), score=0.5).score.tolist() == [0.5, 0.5]
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


def test_what_is_masked_is_no_number() -> None:
    gone = np.array([False, True, False, False])
    points = np.arange(12.0).reshape(4, 3)
    rows = np.repeat(gone[:, None], 3, axis=1)
    for kind in (np.float64, np.float32, np.int32):
        xyz = Cloud(np.ma.masked_array(points.astype(kind), rows)).xyz
        assert type(xyz) is np.ndarray
        np.testing.assert_array_equal(xyz, np.where(rows, np.nan, points).astype(np.float32))
    assert type(Cloud(np.ma.masked_array(points.astype(np.float32))).xyz) is np.ndarray
    one = np.ma.masked_array(points, np.stack([gone, ~gone & False, ~gone & False], axis=1))  # in x alone
    np.testing.assert_array_equal(np.isnan(Cloud(one).xyz), rows)
    colours = Cloud(points, np.ma.masked_array(np.full((4, 3), 9, np.uint8), rows)).rgb
    np.testing.assert_array_equal(colours, np.where(rows, 0, 9))
    masked = np.ma.masked_array([0.0, 0.0, 1.0], [False, True, False])
    for name in ("g1", "g2"):
        with pytest.raises(GraspError, match=rf"{name}: \[0\.0, nan, 1\.0\] is not finite"):
            Grasp(**{"g1": [1.0, 1.0, 1.0], "g2": [2.0, 1.0, 1.0], "rotation": np.eye(3)} | {name: masked})
    with pytest.raises(GraspError, match=r"rotation: .* is not finite"):
        Grasp([0, 0, 1], [1, 0, 1], np.ma.masked_equal(np.eye(3), 1.0))
    grasps = Grasps(
        np.ma.masked_array([[0.0, 0.0, 1.0]] * 2, [[False] * 3, [True] * 3]), np.ones((2, 3)), np.stack([np.eye(3)] * 2)
    )
    assert np.isnan(grasps.g1).any(axis=1).tolist() == [False, True]


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


def test_grasps_and_readings_are_equal_by_their_numbers() -> None:
    grasps = Grasps([[0.0, 0.0, 1.0], [0.0, 0.1, 1.0]], [[0.0, 0.05, 1.0], [0.0, 0.2, 1.0]], object_id=["a", "b"])
    read = biotac_touch(np.arange(50.0))
    rows = Predictions(np.stack([read.values, read.values + 1.0]), grasps, BIOTAC)
    for one, other in ((grasps, grasps[::-1]), (grasps[0], grasps[1]), (rows, rows[::-1]), (rows[0], rows[1])):
        twin = copy.deepcopy(one)
        assert one == twin
        assert hash(one) == hash(twin)
        assert one != other
        assert one != 3
    assert read == biotac_touch(np.arange(50.0))
    assert grasps.index(grasps[1]) == 1
    assert grasps[0] in grasps
    assert grasps[0] not in grasps[1:]
    assert grasps[0] != dataclasses.replace(grasps[0], object_id="c")


def test_heights_and_poses_of_lists_and_whole_numbers_are_those_of_their_floats() -> None:
    plane = Plane([0.0, 0.0, 1.0], -0.5)
    for points in ([[0, 0, 1], [0, 0, 1000]], np.array([[0, 0, 1], [0, 0, 1000]], np.uint16)):
        np.testing.assert_array_equal(plane.height(points), [0.5, 999.5])
    assert plane.moved(np.eye(4).tolist()).coefficients.tolist() == plane.coefficients.tolist()


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
