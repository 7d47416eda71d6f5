# SPDX-License-Identifier: Apache-2.0
"""Hard cases: degenerate, damaged and absurd clouds, grasps and tables, each with its expected outcome.

An outcome is "ok" or the pattern of the reason with which the case is refused.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from scene_builders import table_scene

from foretouch.types import ASSUMED_TABLE, Cloud, Grasp, Plane

MANY = 1_000_000  # points of the largest clouds

_AWAY = np.array([0.02, -0.01, 1.2])  # where objects are [m]
_FEW = "fewer than|finite points, GeoGrasp needs"
_PLACE = "in one place|in 1 voxel"
_BEYOND = "max_range_m|beyond"
_NO_SLAB = "of the grasp plane; from it the object spans"  # nothing at the middle of the object
_NO_PAIR = "near the grasp plane leave no two contacts"


@dataclass(frozen=True, eq=False)
class SceneCase:
    """The cloud of a whole scene."""

    name: str
    cloud: Cloud
    segmented: str = "ok"  # status of the segmentation
    reason: str = ""  # pattern of its reason


def ball(n: int = 2000, radius_m: float = 0.04) -> np.ndarray:
    """(n, 3) on a sphere around the origin."""
    points = np.random.default_rng(1).normal(size=(n, 3))
    return radius_m * points / np.linalg.norm(points, axis=1, keepdims=True)


def bar() -> np.ndarray:
    """The visible half of a lying cylinder of 50 mm by 160 mm, along x."""
    rng = np.random.default_rng(3)
    angle, along = rng.uniform(np.pi, 2.0 * np.pi, 3000), rng.uniform(-0.08, 0.08, 3000)
    return np.stack([along, 0.025 * np.cos(angle), 0.025 * np.sin(angle)], axis=1)


def _cube() -> np.ndarray:
    """The three faces of a cube of 60 mm that a camera can see."""
    a, b = np.meshgrid(np.linspace(-0.03, 0.03, 26), np.linspace(-0.03, 0.03, 26))
    edge = np.full(a.size, -0.03)
    faces = [np.stack([(a.ravel(), b.ravel(), edge)[(i + k) % 3] for i in range(3)], axis=1) for k in range(3)]
    return np.concatenate(faces)


def _lid() -> np.ndarray:
    """The round lid of a can that is seen along its axis."""
    rng = np.random.default_rng(2)
    angle, r = rng.uniform(0.0, 2.0 * np.pi, 2000), 0.033 * np.sqrt(rng.random(2000))
    return np.stack([r * np.cos(angle), r * np.sin(angle), np.zeros(2000)], axis=1)


def _sheet() -> np.ndarray:
    """A sheet of 80 x 50 mm seen at its edge, one row thick."""
    a, b = np.meshgrid(np.linspace(-0.04, 0.04, 60), np.linspace(-0.025, 0.025, 40))
    return np.stack([a.ravel(), np.zeros(a.size), b.ravel()], axis=1)


def across(width_m: float = 0.05, middle: np.ndarray = _AWAY, axis: int = 1) -> Grasp:
    """A grasp along a coordinate axis, with the hand's Z along it."""
    half = np.eye(3)[axis] * width_m / 2.0
    x, z = np.eye(3)[(axis + 1) % 3], np.eye(3)[axis]
    return Grasp(middle + half, middle - half, np.stack([x, np.cross(z, x), z], axis=1))


@dataclass(frozen=True, eq=False)
class ObjectCase:
    """The cloud of one object, its table and a grasp."""

    name: str
    cloud: Cloud
    planned: str = "ok"  # outcome of `plan_grasps` by method `original`
    predicted: str = "ok"  # outcome of the touch models for `grasp`
    grasp: Grasp = across()
    plane: Plane = ASSUMED_TABLE
    completed: str = ""  # outcome by method `completed`, where it is another

    @property
    def by_default(self) -> str:
        """Outcome of `plan_grasps` by the default method."""
        return self.completed or self.planned


def _cloud(points: np.ndarray) -> Cloud:
    with np.errstate(over="ignore"):
        return Cloud(points.astype(np.float32))


def object_cases() -> Iterator[ObjectCase]:
    """Clouds of one object."""
    yield from _shapes()
    yield from _scales()
    yield from _numbers()
    cloud = _cloud(bar() + _AWAY)
    for name, grasp, reason in _grasps():
        yield ObjectCase(f"grasp {name}", cloud, "ok", reason, grasp)
    for name, coefficients, planned in (
        ("from above", (0.0, 0.0, 1.0, -1.27), "ok"),
        ("from below", (0.0, 0.0, -1.0, 1.27), "ok"),
        ("steep", (0.0, -0.95, -0.312, 0.5), "ok"),
        ("vertical", (0.0, 1.0, 0.0, 0.0), "ok"),
        ("behind the camera", (0.0, 0.0, 1.0, 1.27), "plane: .* is behind the camera"),
        ("1e9 m away", (0.0, 0.0, 1.0, -1e9), "plane: .* more than max_range_m"),
        ("denormal offset", (0.0, 0.0, 1.0, -5e-324), "ok"),
    ):
        yield ObjectCase(f"table {name}", cloud, planned, plane=Plane.from_coefficients(coefficients))


def _shapes() -> Iterator[ObjectCase]:
    for n in range(8):
        # Sparse points near the grasp plane: GeoGrasp's slab of 14 mm holds none or one of some.
        planned = _FEW if n < 3 else "ok" if n in (5, 6) else "near the grasp plane|of the grasp plane"
        default = _FEW if n < 3 else "meets 8 points"
        yield ObjectCase(f"{n} points", _cloud(bar()[:n] + _AWAY), planned, _FEW, completed=default)
    yield ObjectCase("all points equal", _cloud(np.tile(_AWAY, (500, 1))), _PLACE, _PLACE, completed="at one place")
    line = np.outer(np.linspace(-0.05, 0.05, 500), [0.0, 1.0, 0.0]) + _AWAY
    turn = np.array([[np.cos(0.7), -np.sin(0.7), 0.0], [np.sin(0.7), np.cos(0.7), 0.0], [0.0, 0.0, 1.0]])
    yield ObjectCase("oblique line", _cloud(line @ turn.T), grasp=across(middle=_AWAY @ turn.T))
    aside = np.array([0.0, 0.06, 0.0])
    for name, points, *planned in (
        ("bar", bar(), "ok"),
        ("ball", ball(), "ok"),
        ("cube", _cube(), "ok"),
        ("cylinder end-on", _lid(), "ok"),
        ("ring", _lid() * 0.04 / np.linalg.norm(_lid(), axis=1, keepdims=True), "ok"),
        ("coplanar", _sheet()[:, [0, 2, 1]], "ok"),
        ("duplicated", np.repeat(bar(), 3, axis=0), "ok"),
        ("a million points", np.concatenate([ball(MANY // 2), 0.5 * ball(MANY // 2)]), "ok"),
        ("collinear", line - _AWAY, _NO_PAIR, "ok"),
        ("thin sheet", _sheet(), _NO_PAIR, "ok"),
        ("two clusters", np.concatenate([ball(600, 0.02) + aside, ball(600, 0.02) - aside]), _NO_SLAB, "ok"),
        ("two points, repeated", np.repeat([aside / 2, -aside / 2], 300, axis=0), _NO_SLAB, "have no axis"),
    ):
        yield ObjectCase(name, _cloud(points + _AWAY), planned[0], completed=planned[-1])
    outlier = np.concatenate([bar() + _AWAY, [[0.0, 0.0, 9.0]]])
    yield ObjectCase("far outlier", _cloud(outlier), "extends .* more than max_extent_m", "max_extent_m")


def _scales() -> Iterator[ObjectCase]:
    for exponent in range(-9, 4):
        small, large = "less than min_extent_m|in one place", "more than max_extent_m|more than max_range_m"
        outcome = "ok" if exponent in (-1, -2) else small if exponent < -1 else large
        yield ObjectCase(f"bar of 1.6e{exponent} m", _cloud(10.0 ** (exponent + 1) * bar() + _AWAY), outcome, outcome)
    for name, away, reason in (
        ("0.01 m away", [0.0, 0.0, 0.01], "less than min_range_m"),
        ("100 m away", [0.0, 0.0, 100.0], "more than max_range_m|beyond 1000 m"),
        ("10 km away", [0.0, 0.0, 1e4], "more than max_range_m|beyond 1000 m"),
        ("10 km aside", [1e4, 0.0, 1.2], _BEYOND),
    ):
        yield ObjectCase(f"bar {name}", _cloud(bar() + away), reason, reason, across(middle=np.array(away)))
    grasp = across(middle=np.zeros(3))
    yield ObjectCase("denormal", _cloud(ball(500, 1e-42)), "min_extent_m", "min_extent_m", grasp)
    flat = _cloud((bar() + _AWAY) * [1e-42, 1.0, 1.0])
    yield ObjectCase("denormal x", flat, grasp=across(middle=_AWAY * [0.0, 1.0, 1.0]))


def _numbers() -> Iterator[ObjectCase]:
    for value in (np.nan, np.inf, -np.inf):
        points = bar() + _AWAY
        points[::5, 1] = value
        yield ObjectCase(f"every fifth y {value}", _cloud(points))
        yield ObjectCase(f"only {value}", _cloud(np.full((300, 3), value)), _FEW, _FEW)
    points = bar() + _AWAY
    points[7, 0] = 3e38
    yield ObjectCase("one x of 3e38", _cloud(points), "beyond|max_extent_m|max_range_m", "max_extent_m|max_range_m")
    yield ObjectCase("big-endian", _cloud((bar() + _AWAY).astype(">f4")))


def _grasps() -> Iterator[tuple[str, Grasp, str]]:
    fine, x, y = across(), _AWAY * [0.0, 1.0, 1.0], np.array([0.0, 1.0, 0.0])
    yield "along the axis", across(0.16, axis=0), "ok"
    yield "1 nm wide", across(1e-9), "ok"
    yield "denormal width", Grasp(x + np.array([5e-324, 0, 0]), x, np.roll(np.eye(3), -1, axis=1)), "ok"
    yield "1 m wide", across(1.0), "more than max_width_m"
    yield "50 m off", across(middle=_AWAY + 50.0 * y), "more than max_distance_m"
    yield "1e160 m off", across(1e150, _AWAY + 1e160 * y), "max_width_m|max_distance_m"
    yield "1e300 m wide", across(1e300), "more than max_width_m"
    mirror = np.diag([1.0, 1.0, -1.0])
    for name, rotation in (("left-handed", fine.rotation @ mirror), ("1e300", 1e300 * mirror)):
        unchecked = Grasp(fine.g1, fine.g2, fine.rotation)
        object.__setattr__(unchecked, "rotation", rotation)  # which the constructor refuses
        yield f"{name} rotation", unchecked, "not a rotation matrix"


def scene_cases() -> Iterator[SceneCase]:
    """Clouds of whole scenes, as images and as lists of points."""
    for name, change, status, reason in _changes():
        xyz = change(table_scene())
        yield SceneCase(f"{name}, image", Cloud(xyz), status, reason)
        yield SceneCase(f"{name}, list", Cloud(xyz.reshape(-1, 3)), status, reason)
    image = table_scene()
    shuffled = np.random.default_rng(0).permutation(image.reshape(-1, 3)).reshape(image.shape)
    yield SceneCase("shuffled pixels", Cloud(shuffled), "bad_cloud", "beside the rays")
    large = table_scene(width=1280, height=800)  # 1,024,000 points
    yield SceneCase("a million points, image", Cloud(large))
    yield SceneCase("a million points, list", Cloud(large.reshape(-1, 3)))
    for tilt in (0.0, 1.0, 1.3):
        yield SceneCase(f"table at {tilt} rad", Cloud(table_scene(tilt)))
    yield SceneCase("bare table", Cloud(table_scene(rise=0.0)), "no_object", "nothing stands more")
    for n in range(4):
        status = ("too_few_points", "points in range, fewer than") if n else ("empty_cloud", "no point")
        yield SceneCase(f"{n} points in a list", _cloud(bar()[:n] + _AWAY), *status)
    yield SceneCase("only a ball", _cloud(ball(5000) + _AWAY), "no_plane", "plane holds|narrow")
    line = np.outer(np.linspace(0.5, 1.0, 900), [0.1, 0.1, 1.0])
    yield SceneCase("only a line", _cloud(line), "no_plane", "mm wide, less than")


def _changes() -> Iterator[tuple[str, Callable[[np.ndarray], np.ndarray], str, str]]:
    def damaged(value: float, axis: int, step: int = 0) -> Callable[[np.ndarray], np.ndarray]:
        """Every `step`-th finite point in random order, or without a step the middle one."""

        def change(xyz: np.ndarray) -> np.ndarray:
            index = np.flatnonzero(np.isfinite(xyz[..., 2]))
            some = np.random.default_rng(5).permutation(index)[: len(index) // step] if step else index[len(index) // 2]
            xyz.reshape(-1, 3)[some, axis] = np.float32(value)
            return xyz

        return change

    def scaled(factor: float) -> Callable[[np.ndarray], np.ndarray]:
        return lambda xyz: (xyz.astype(np.float64) * factor).astype(np.float32)

    yield "as it is", scaled(1.0), "ok", ""
    for axis, values in enumerate([(1e10, 1e20, -3e38, np.inf, np.nan)] * 2):
        for value in values:
            yield f"one {'xy'[axis]} of {value:g}", damaged(value, axis), "ok", ""
            yield f"5 % of {'xy'[axis]} {value:g}", damaged(value, axis, 20), "ok", ""
    for value in (np.inf, -np.inf, np.nan, 0.0, -1.0, 3e38, 1e-42):
        yield f"5 % of z {value:g}", damaged(value, 2, 20), "ok", ""
    for factor in (1e-42, 1e-9, 1e-3, 1e3):
        yield f"scaled by {factor:g}", scaled(factor), "empty_cloud", "no point between 0.16 and 2 m"
    yield "only NaN", scaled(float("nan")), "empty_cloud", "is finite"
    yield "all x 1e20", damaged(1e20, 0, 1), "bad_cloud", "beside the rays|field of view|field_of_view"
    yield "10 km away", lambda xyz: xyz + np.float32(1e4), "empty_cloud", "no point between"
    yield "behind the camera", lambda xyz: -xyz, "unknown_frame", "not_optical: 100% of the points are at z <= 0"
    # From x right, y down, z forward to x forward, y left, z up.
    to_link = lambda xyz: np.ascontiguousarray(xyz[..., [2, 0, 1]] * np.float32([1, -1, -1]))  # noqa: E731
    yield "in the frame of the link", to_link, "unknown_frame", "not_optical: .* in view along x"
