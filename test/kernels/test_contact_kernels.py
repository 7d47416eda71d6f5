# SPDX-License-Identifier: Apache-2.0
"""The compiled functions of the contact model against NumPy, SciPy and hard inputs."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from contact_model_builders import HAND, cylinder, hand_estimator, lines_sheets_and_repeated_points, small_estimator
from hypothesis import given, settings
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation
from sklearn.ensemble import ExtraTreesRegressor

from foretouch import kernels
from foretouch.errors import ModelError
from foretouch.models.contact.hand_features import FEATURES, SLOPE_FEATURES, HandScene
from foretouch.models.contact.regressors import CompiledForests, Forest, KernelRegression
from foretouch.models.registry import load_model
from foretouch.models.touch_model import TouchModel
from foretouch.types import Cloud, Grasp

PLACE = np.array([0.02, -0.03, 1.2])
SLOPES = np.array([name in SLOPE_FEATURES for name in FEATURES])


def rough(rng: np.random.Generator, spread: float = 0.0004) -> np.ndarray:
    """A cylinder as a camera sees it: no two points in one plane by chance."""
    points = cylinder(0.03, PLACE)
    return points + spread * rng.normal(size=points.shape)


def grasps_on(points: np.ndarray, count: int, rng: np.random.Generator) -> list[Grasp]:
    pairs = rng.integers(0, len(points), (count, 2))
    hands = Rotation.random(count, random_state=0).as_matrix()
    ends = zip(points[pairs[:, 0]], points[pairs[:, 1]] + 1e-3, hands, strict=True)
    return [Grasp(g1, g2, hand) for g1, g2, hand in ends]


def both(points: np.ndarray, grasps: list[Grasp]) -> tuple[np.ndarray, np.ndarray]:
    """Rows of the compiled form and of NumPy."""
    compiled = HandScene(points).describe(grasps)
    with kernels.disabled():
        return compiled, HandScene(points).describe(grasps)


def test_contacts_on_a_surface_differ_by_rounding(rng) -> None:
    points = rough(rng)
    compiled, plain = both(points, grasps_on(points, 60, rng))
    assert_allclose(compiled[:, ~SLOPES], plain[:, ~SLOPES], rtol=1e-12, atol=1e-12)
    assert_allclose(compiled[:, SLOPES], plain[:, SLOPES], rtol=0.0, atol=1e-9)
    assert np.abs(plain[:, SLOPES]).max() > 0.5  # not all are zero


def test_contacts_at_the_edge_and_far_away(rng) -> None:
    points = rough(rng)
    places = [PLACE + step for step in ([0.0, 0.0, 0.055], [0.0, 0.08, 0.0], [1e3, 0.0, 0.0], [0.0, -1e100, 0.0])]
    places += [points[0] + 0.03, points.min(axis=0), points.max(axis=0)]
    compiled, plain = both(points, [Grasp(place, PLACE, HAND) for place in places])
    assert_allclose(compiled, plain, rtol=1e-12, atol=1e-9)


def test_a_contact_whose_distance_overflows_touches_nothing(rng) -> None:
    """SciPy's tree refuses it."""
    far = [Grasp(np.array([x, -x, 0.0]), PLACE, HAND) for x in (1e200, 1e308)]
    with np.errstate(over="ignore", invalid="ignore"):
        rows = HandScene(rough(rng)).describe(far)
    assert_array_equal(rows[:, -28:-14], 0.0)


@settings(max_examples=60, deadline=None)
@given(case=lines_sheets_and_repeated_points(PLACE))
def test_points_in_a_plane_are_left_to_numpy(case) -> None:
    """Where rounding decides, both forms give the same bits."""
    points, g1, g2 = case
    compiled, plain = both(points, [Grasp(g1, g2, HAND), Grasp(g2, g1, HAND)])
    assert_allclose(compiled[:, ~SLOPES], plain[:, ~SLOPES], rtol=1e-9, atol=1e-9)
    assert_allclose(compiled[:, SLOPES], plain[:, SLOPES], rtol=0.0, atol=1e-6)


def test_a_plane_is_left_to_numpy(rng) -> None:
    points = np.column_stack([rng.uniform(-0.05, 0.05, (3000, 2)), np.full(3000, 0.123)]) + PLACE
    compiled, plain = both(points, grasps_on(points, 20, rng))
    assert_array_equal(compiled[:, -28:], plain[:, -28:])


def test_a_million_points(rng) -> None:
    turns, heights = rng.uniform(0.0, 2.0 * np.pi, 1_000_000), rng.uniform(-0.25, 0.25, 1_000_000)
    points = PLACE + np.column_stack([0.05 * np.cos(turns), heights, 0.05 * np.sin(turns)])
    points += 0.001 * rng.normal(size=points.shape)
    compiled, plain = both(points.astype(np.float32), grasps_on(points, 2, rng))
    assert_allclose(compiled, plain, rtol=1e-9, atol=1e-10)


def test_a_huge_object_is_no_grid(rng) -> None:
    """The cells become larger, not more."""
    points = rough(rng) * [1e6, 1e6, 1.0]
    compiled, plain = both(points, grasps_on(points, 5, rng))
    assert_allclose(compiled, plain, rtol=1e-9, atol=1e-9)


def test_a_row_is_the_same_alone_and_among_others(rng) -> None:
    points = rough(rng)
    grasps = grasps_on(points, 30, rng)
    scene = HandScene(points)
    assert_array_equal(scene.describe(grasps), np.concatenate([scene.describe([one]) for one in grasps]))
    assert scene.describe([]).shape == (0, len(FEATURES))


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


@pytest.mark.parametrize(("trees", "outputs"), [(1, 1), (2, 1), (7, 1), (60, 1), (131, 1), (280, 1), (1, 3), (60, 50)])
def test_a_forest_gives_the_same_bits(trees: int, outputs: int, rng) -> None:
    rows = hard_rows(rng)
    with np.errstate(over="ignore"):
        compiled = forest(trees, outputs).predict(rows)
        with kernels.disabled():
            assert_array_equal(compiled, forest(trees, outputs).predict(rows))


def test_several_forests_give_what_each_gives(rng) -> None:
    forests = [forest(7, 3), forest(60, 1), forest(2, 1)]
    with np.errstate(over="ignore"):
        rows = hard_rows(rng).astype(np.float32).astype(np.float64)
        expected = np.hstack([one.predict(rows) for one in forests])
        assert_array_equal(CompiledForests(forests).predict(rows), expected)
    assert CompiledForests(forests).predict(np.empty((0, 6))).shape == (0, 5)


def test_rows_that_are_too_short_are_not_read_beyond_their_end(rng) -> None:
    assert not CompiledForests([forest(60, 1)]).takes(np.zeros((3, 2)))
    with pytest.raises(IndexError):
        forest(60, 1).predict(rng.normal(size=(3, 2)))


@pytest.mark.parametrize(("name", "value"), [("children", 10**6), ("leaf", 10**6), ("roots", -1)])
def test_a_damaged_forest_is_not_walked(name: str, value: int) -> None:
    array = getattr(forest(7, 3), name).copy()
    array.reshape(-1)[0] = value
    with pytest.raises(ModelError, match=name):
        replace(forest(7, 3), **{name: array}).predict(np.zeros((1, 6)))


@pytest.mark.parametrize(("known", "outputs"), [(1, 1), (31, 50), (32, 56), (65, 57), (400, 50)])
def test_the_kernel_differs_by_rounding(known: int, outputs: int, rng) -> None:
    weight = rng.normal(size=(known, outputs)).astype(np.float32)
    model = KernelRegression(
        rng.normal(size=7),
        rng.uniform(0.5, 2.0, 7),
        rng.normal(size=(known, 7)).astype(np.float32),
        weight,
        np.array(0.8),
    )
    rows = rng.normal(size=(70, 7))
    rows[0], rows[1] = 1e300, np.inf
    compiled = model.predict(rows)
    with kernels.disabled():
        assert_allclose(compiled, model.predict(rows), rtol=0.0, atol=1e-13 * known)
    assert_array_equal(compiled, np.concatenate([model.predict(row[None]) for row in rows]))
    assert model.predict(rows[:0]).shape == (0, outputs)


def test_a_value_that_is_not_finite_stays_so(rng) -> None:
    model = hand_estimator().kernel
    rows = np.full((2, model.known.shape[1]), np.nan)
    with kernels.disabled():
        plain = model.predict(rows)
    assert_array_equal(np.isnan(model.predict(rows)), np.isnan(plain))


@pytest.mark.parametrize("fitted", [small_estimator, hand_estimator], ids=["as contact-v1", "as contact-v2"])
def test_an_estimate_differs_by_rounding(fitted, rng) -> None:
    points = rough(rng)
    cloud = Cloud(points.astype(np.float32))
    grasps = grasps_on(points, 12, rng)
    compiled = fitted().estimate(cloud, grasps)
    with kernels.disabled():
        plain = fitted().estimate(cloud, grasps)
    assert_allclose(compiled.counts, plain.counts, rtol=0.0, atol=1e-6)
    assert_array_equal(compiled.in_distribution, plain.in_distribution)


@pytest.fixture(scope="module")
def default() -> TouchModel:
    return load_model()


@pytest.mark.parametrize("count", [1, 30])
def test_the_default_model_predicts_the_same_without_kernels(default: TouchModel, count: int, rng) -> None:
    points = rough(rng)
    cloud, grasps = Cloud(points.astype(np.float32)), grasps_on(points, count, rng)
    compiled = default.predict(cloud, grasps)
    with kernels.disabled():
        plain = default.predict(cloud, grasps)
    for one, other in zip(compiled, plain, strict=True):
        assert (one.status, one.flags, one.reason) == (other.status, other.flags, other.reason)
        for part in ("value", "lower", "upper"):
            found, wanted = (getattr(each, part).vector() for each in (one, other))
            assert_allclose(found, wanted, rtol=0.0, atol=1e-6)
