# SPDX-License-Identifier: Apache-2.0
"""The compiled functions of the models against NumPy, SciPy and hard inputs."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from contact_model_builders import HAND, cylinder, lines_sheets_and_repeated_points, small_estimator
from every_case import every_case, every_refusal
from hypothesis import given, settings
from kernels.references import models as reference
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation
from sklearn.ensemble import ExtraTreesRegressor

from foretouch.cloud.geometry.sampling import UnitSphereFrame
from foretouch.errors import ModelError
from foretouch.models.contact import above
from foretouch.models.contact.features import FEATURES, HandFrameFeatures
from foretouch.models.contact.regressors import CompiledForests, Forest, KernelRegression
from foretouch.models.network.preparation import PreparedCloud, _nearest
from foretouch.types import Grasp, Grasps

PLACE = np.array([0.02, -0.03, 1.2])


def rough(rng: np.random.Generator, spread: float = 0.0004) -> np.ndarray:
    """A cylinder as a camera sees it: no two points in one plane by chance."""
    points = cylinder(0.03, PLACE)
    return points + spread * rng.normal(size=points.shape)


def grasps_on(points: np.ndarray, count: int, rng: np.random.Generator) -> list[Grasp]:
    pairs = rng.integers(0, len(points), (count, 2))
    hands = Rotation.random(count, random_state=0).as_matrix()
    ends = zip(points[pairs[:, 0]], points[pairs[:, 1]] + 1e-3, hands, strict=True)
    return [Grasp(g1, g2, hand) for g1, g2, hand in ends]


def test_contacts_on_a_surface_differ_by_rounding_and_those_on_a_plane_are_left_to_numpy(rng) -> None:
    points = rough(rng)
    ends = [PLACE + step for step in ([0.0, 0.0, 0.055], [0.0, 0.08, 0.0], [1e3, 0.0, 0.0])]
    ends += [points[0] + 0.03, points.min(axis=0), points.max(axis=0)]
    wide = points * [1e6, 1e6, 1.0]  # the cells become larger, not more
    grasps = grasps_on(points, 60, rng)
    cases = {
        "surface": (points, grasps),
        "edge, and far away": (points, [Grasp(end, PLACE, HAND) for end in ends]),
        "huge": (wide, grasps_on(wide, 5, rng)),
    }

    def check(points: np.ndarray, grasps: list[Grasp]) -> None:
        columns = Grasps.of(grasps)
        contacts = np.concatenate([columns.g1, columns.g2])
        fingers = np.concatenate([columns.rotation, -columns.rotation])
        found = HandFrameFeatures(points)._contacts(contacts, fingers)
        expected = reference.contact_rows(points, contacts, fingers)
        assert_allclose(found[:, :5], expected[:, :5], rtol=0.0, atol=1e-9)
        assert_allclose(found[:, 5:], expected[:, 5:], rtol=0.0, atol=1e-7)

    every_case(cases, check)
    scene = HandFrameFeatures(points)  # a row is the same alone and among others
    assert_array_equal(scene.describe(grasps[:30]), np.concatenate([scene.describe([grasp]) for grasp in grasps[:30]]))
    assert scene.describe([]).shape == (0, len(FEATURES))
    far = [Grasp(np.array([x, -x, 0.0]), PLACE, HAND) for x in (1e200, 1e308)]  # distances that overflow
    with np.errstate(over="ignore", invalid="ignore"):
        assert_array_equal(scene.describe(far)[:, -28:-14], 0.0)
    points = np.column_stack([rng.uniform(-0.05, 0.05, (3000, 2)), np.full(3000, 0.123)]) + PLACE
    scene, grasps = HandFrameFeatures(points), Grasps.of(grasps_on(points, 20, rng))
    assert_array_equal(scene._contacts(grasps.g1, grasps.rotation), scene._summed(grasps.g1, grasps.rotation))


@settings(max_examples=60, deadline=None)
@given(case=lines_sheets_and_repeated_points(PLACE))
def test_where_rounding_decides_numpy_describes_the_contact(case) -> None:
    """Compiled or not, a row is that of `_summed` within rounding."""
    points, g1, g2 = case
    scene = HandFrameFeatures(points)
    contacts, fingers = np.stack([g1, g2]), np.stack([HAND, HAND])
    rows, plain = scene._contacts(contacts, fingers), scene._summed(contacts, fingers)
    assert_allclose(rows[:, :5], plain[:, :5], rtol=1e-9, atol=1e-9)
    assert_allclose(rows[:, 5:], plain[:, 5:], rtol=0.0, atol=1e-6)


@cache
def forest(trees: int, outputs: int) -> Forest:
    rng = np.random.default_rng(trees)
    rows, target = rng.normal(size=(120, 6)), rng.normal(size=(120, outputs))
    model = ExtraTreesRegressor(trees, min_samples_leaf=3, random_state=0).fit(rows, np.squeeze(target))
    return Forest.from_trees([tree.tree_ for tree in model.estimators_])


def hard_rows(rng: np.random.Generator, count: int = 130) -> np.ndarray:
    rows = 2.0 * rng.normal(size=(count, 6))
    rows[:6] = np.array([np.nan, np.inf, -np.inf, 1e300, 0.0, -0.0])[:, None]
    thresholds = forest(7, 3).threshold
    rows[6:26, 0] = thresholds[:20]
    rows[26:46, 1] = np.nextafter(thresholds[:20].astype(np.float32), np.float32(np.inf))
    return rows


def test_a_forest_gives_the_same_bits_alone_and_with_others_and_reads_nothing_beyond_its_end(rng) -> None:
    def check(trees: int, outputs: int) -> None:
        rows = hard_rows(rng)
        with np.errstate(over="ignore"):
            assert_array_equal(forest(trees, outputs).predict(rows), reference.forest(forest(trees, outputs), rows))

    every_case([(1, 1), (2, 1), (7, 1), (60, 1), (131, 1), (280, 1), (1, 3), (60, 50)], check)
    forests = [forest(7, 3), forest(60, 1), forest(2, 1)]
    with np.errstate(over="ignore"):
        rows = hard_rows(rng).astype(np.float32).astype(np.float64)
        expected = np.hstack([one.predict(rows) for one in forests])
        assert_array_equal(CompiledForests(forests).predict(rows), expected)
    assert CompiledForests(forests).predict(np.empty((0, 6))).shape == (0, 5)

    def predict(name: str, value: int) -> None:
        array = getattr(forest(7, 3), name).copy()
        array.reshape(-1)[0] = value
        replace(forest(7, 3), **{name: array}).predict(np.zeros((1, 6)))

    cases = [("children", 10**6), ("leaf", 10**6), ("roots", -1)]
    every_refusal(ModelError, [(name, name, value) for name, value in cases], predict)
    with pytest.raises(ModelError, match=r"rows: shape \(3, 2\) has no column 5"):
        forest(60, 1).predict(np.zeros((3, 2)))


def test_the_kernel_regression_differs_by_rounding(rng) -> None:
    def check(known: int, outputs: int) -> None:
        weight = rng.normal(size=(known, outputs)).astype(np.float32)
        spread, rows_known = rng.uniform(0.5, 2.0, 7), rng.normal(size=(known, 7)).astype(np.float32)
        model = KernelRegression(rng.normal(size=7), spread, rows_known, weight, np.array(0.8))
        rows = rng.normal(size=(70, 7))
        rows[0], rows[1] = 1e300, np.inf
        found = model.predict(rows)
        assert_allclose(found, reference.kernel_regression(model, rows), rtol=0.0, atol=1e-13 * known)
        assert_array_equal(found, np.concatenate([model.predict(row[None]) for row in rows]))
        assert model.predict(rows[:0]).shape == (0, outputs)

    every_case([(1, 1), (31, 50), (32, 56), (65, 57), (400, 50)], check)
    model = small_estimator().kernel
    assert np.isnan(model.predict(np.full((2, model.known.shape[1]), np.nan))).all()


def test_distances_from_the_nearest_point(rng) -> None:
    def check(count: int) -> None:
        points = rng.normal(size=(count, 6)).astype(np.float32) / 3.0
        prepared = PreparedCloud(points, UnitSphereFrame(np.zeros(3), 0.1))
        targets = np.concatenate([rng.normal(size=(40, 3)) * 0.05, 0.1 * points[:1, :3], [[1e3, 0.0, 0.0]]])
        expected = reference.nearest(0.1 * points[:, :3].astype(np.float64), targets)
        assert_allclose(_nearest(prepared, targets), expected, rtol=1e-6, atol=1e-8)
        assert _nearest(prepared, targets[:0]).shape == (0,)

    every_case([1, 15, 16, 750], check)


def test_places_behind_points_are_hidden(rng) -> None:
    points = rough(rng)
    places = points + rng.uniform(-0.03, 0.05, points.shape)
    around = points - PLACE  # the camera is within the object
    cases = {
        "an object": (points, places),
        "around the camera": (around[:50] * [1.0, 1.0, 20.0], places),
        "a picture too large": (np.array([[1e3, 0.0, 1e-3], [-1e3, 1e3, 1e-3]]), places),
        "all behind the camera": (points * [1.0, 1.0, -1.0], places),
        "places behind the camera": (points, places * [1.0, 1.0, -1.0]),
        "no place": (points, places[:0]),
        "no point": (points[:0], places),
    }

    def check(points: np.ndarray, places: np.ndarray) -> None:
        assert_array_equal(above._is_hidden(places, points), reference.is_hidden(places, points))

    every_case(cases, check)
    assert 0.1 < above._is_hidden(places, points).mean() < 0.9
