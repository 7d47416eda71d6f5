# SPDX-License-Identifier: Apache-2.0
"""Hard cases: degenerate, damaged and absurd clouds, grasps and tables, each with its expected outcome.

An outcome is "ok" or the pattern of the reason with which the case is refused.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from foretouch.types import ASSUMED_TABLE, Cloud, Grasp, Plane

Float32 = npt.NDArray[np.float32]
Float64 = npt.NDArray[np.float64]

MANY = 1_000_000  # points of the largest clouds

_AWAY = np.array([0.02, -0.01, 1.2])  # where objects are [m]
_FEW = "fewer than|finite points, GeoGrasp needs"
_PLACE = "in one place|in 1 voxel"
_BEYOND = "max_range_m|beyond"
_NO_SLAB = "of the grasp plane; from it the object spans"  # nothing at the middle of the object
_NO_PAIR = "near the grasp plane leave no two contacts"


@dataclass(frozen=True, eq=False)
class ObjectCase:
    """The cloud of one object, its table and a grasp."""

    name: str
    cloud: Cloud
    planned: str  # outcome of `plan_grasps`
    predicted: str  # outcome of the touch models for `grasp`
    grasp: Grasp
    plane: Plane = ASSUMED_TABLE


@dataclass(frozen=True, eq=False)
class SceneCase:
    """The cloud of a whole scene."""

    name: str
    cloud: Cloud
    segmented: str  # status of the segmentation
    reason: str = ""  # pattern of its reason


def _cloud(points: npt.ArrayLike) -> Cloud:
    with np.errstate(over="ignore"):
        return Cloud(np.asarray(points).astype(np.float32))


def ball(n: int = 2000, radius_m: float = 0.04) -> Float64:
    """(n, 3) on a sphere around the origin."""
    points = np.random.default_rng(1).normal(size=(n, 3))
    return np.asarray(radius_m * points / np.linalg.norm(points, axis=1, keepdims=True), np.float64)


def cube(side_m: float = 0.06) -> Float64:
    """The three faces of a cube that a camera can see."""
    a, b = np.meshgrid(np.linspace(-0.5, 0.5, 26), np.linspace(-0.5, 0.5, 26))
    edge = np.full(a.size, -0.5)
    faces = [np.stack([(a.ravel(), b.ravel(), edge)[(i + k) % 3] for i in range(3)], axis=1) for k in range(3)]
    return side_m * np.concatenate(faces)


def cylinder_end_on(radius_m: float = 0.033) -> Float64:
    """The round lid of a can that is seen along its axis."""
    rng = np.random.default_rng(2)
    angle, r = rng.uniform(0.0, 2.0 * np.pi, 2000), radius_m * np.sqrt(rng.random(2000))
    return np.stack([r * np.cos(angle), r * np.sin(angle), np.zeros(2000)], axis=1)


def sheet() -> Float64:
    """A sheet of 80 x 50 mm seen at its edge, one row thick."""
    a, b = np.meshgrid(np.linspace(-0.04, 0.04, 60), np.linspace(-0.025, 0.025, 40))
    return np.stack([a.ravel(), np.zeros(a.size), b.ravel()], axis=1)


def ring() -> Float64:
    """A thin ring of 80 mm."""
    angle = np.linspace(0.0, 2.0 * np.pi, 800, endpoint=False)
    return np.stack([0.04 * np.cos(angle), 0.04 * np.sin(angle), np.zeros(800)], axis=1)


def bar() -> Float64:
    """The visible half of a lying cylinder of 50 mm by 160 mm, along x."""
    rng = np.random.default_rng(3)
    angle, along = rng.uniform(np.pi, 2.0 * np.pi, 3000), rng.uniform(-0.08, 0.08, 3000)
    return np.stack([along, 0.025 * np.cos(angle), 0.025 * np.sin(angle)], axis=1)


def across(width_m: float = 0.05, middle: npt.ArrayLike = _AWAY, axis: int = 1) -> Grasp:
    """A grasp along a coordinate axis, with the hand's Z along it."""
    half = np.zeros(3)
    half[axis] = width_m / 2.0
    z = np.eye(3)[axis]
    x = np.eye(3)[(axis + 1) % 3]
    return Grasp(np.asarray(middle) + half, np.asarray(middle) - half, np.stack([x, np.cross(z, x), z], axis=1))


def object_cases() -> Iterator[ObjectCase]:
    """Clouds of one object."""
    yield from _few_points()
    yield from _shapes()
    yield from _scales()
    yield from _numbers()
    yield from _grasps()
    yield from _tables()


def _few_points() -> Iterator[ObjectCase]:
    grasp = across()
    for n in range(8):
        # Sparse points near the grasp plane: GeoGrasp's slab of 14 mm holds none or one of some.
        planned = _FEW if n < 3 else "ok" if n in (5, 6) else "near the grasp plane|of the grasp plane"
        yield ObjectCase(f"{n} points", _cloud(bar()[:n].reshape(-1, 3) + _AWAY), planned, _FEW, grasp)
    yield ObjectCase("all points equal", _cloud(np.tile(_AWAY, (500, 1))), _PLACE, _PLACE, grasp)
    line = np.outer(np.linspace(-0.05, 0.05, 500), [0.0, 1.0, 0.0]) + _AWAY
    yield ObjectCase("collinear", _cloud(line), _NO_PAIR, "ok", grasp)
    yield ObjectCase("oblique line", _cloud(line @ _turn().T), "ok", "ok", across(middle=_AWAY @ _turn().T))
    yield ObjectCase("duplicated", _cloud(np.repeat(bar() + _AWAY, 3, axis=0)), "ok", "ok", grasp)
    pair = np.repeat(np.array([[0.0, 0.03, 0.0], [0.0, -0.03, 0.0]]) + _AWAY, 300, axis=0)
    yield ObjectCase("two points, repeated", _cloud(pair), _NO_SLAB, "ok", grasp)


def _shapes() -> Iterator[ObjectCase]:
    for name, points in (
        ("ball", ball()),
        ("cube", cube()),
        ("cylinder end-on", cylinder_end_on()),
        ("thin sheet", sheet()),
        ("ring", ring()),
        ("bar", bar()),
        ("coplanar", sheet()[:, [0, 2, 1]]),
        ("two clusters", np.concatenate([ball(600, 0.02) + sign * np.array([0.0, 0.06, 0.0]) for sign in (1.0, -1.0)])),
    ):
        planned = {"thin sheet": _NO_PAIR, "two clusters": _NO_SLAB}.get(name, "ok")
        yield ObjectCase(name, _cloud(points + _AWAY), planned, "ok", across())
    dense = np.concatenate([ball(MANY // 2), 0.5 * ball(MANY // 2)]) + _AWAY
    yield ObjectCase("a million points", _cloud(dense), "ok", "ok", across())
    outlier = np.concatenate([bar() + _AWAY, [[0.0, 0.0, 9.0]]])
    yield ObjectCase("far outlier", _cloud(outlier), "extends .* more than max_extent_m", "max_extent_m", across())


def _scales() -> Iterator[ObjectCase]:
    for exponent in range(-9, 4):
        size = 10.0**exponent
        fits = exponent in (-1, -2)  # 160 and 16 mm long
        reason = (
            "less than min_extent_m|in one place" if exponent < -1 else "more than max_extent_m|more than max_range_m"
        )
        outcome = "ok" if fits else reason
        yield ObjectCase(f"bar of 1.6e{exponent} m", _cloud(10.0 * size * bar() + _AWAY), outcome, outcome, across())
    for distance_m in (0.01, 100.0, 1e4):
        away = np.array([0.0, 0.0, distance_m])
        reason = "less than min_range_m" if distance_m < 1.0 else "more than max_range_m|beyond 1000 m"
        yield ObjectCase(f"bar {distance_m:g} m away", _cloud(bar() + away), reason, reason, across(middle=away))
    aside = np.array([1e4, 0.0, 1.2])
    yield ObjectCase("10 km aside", _cloud(bar() + aside), _BEYOND, _BEYOND, across(middle=aside))
    tiny = ball(500, 1e-42)
    yield ObjectCase("denormal", _cloud(tiny), "min_extent_m", "min_extent_m", across(middle=np.zeros(3)))
    mixed = bar() + _AWAY
    mixed[:, 0] *= 1e-42
    yield ObjectCase("denormal x", _cloud(mixed), "ok", "ok", across(middle=_AWAY * [0.0, 1.0, 1.0]))


def _numbers() -> Iterator[ObjectCase]:
    for name, value in (("NaN", np.nan), ("Inf", np.inf), ("-Inf", -np.inf)):
        points = bar() + _AWAY
        points[::5, 1] = value
        yield ObjectCase(f"every fifth y {name}", _cloud(points), "ok", "ok", across())
        nothing = np.full((300, 3), value)
        yield ObjectCase(f"only {name}", _cloud(nothing), _FEW, _FEW, across())
    points = bar() + _AWAY
    points[7, 0] = 3e38
    yield ObjectCase(
        "one x of 3e38", _cloud(points), "beyond|max_extent_m|max_range_m", "max_extent_m|max_range_m", across()
    )
    for name, xyz in (("float64", (bar() + _AWAY).astype(np.float64)), ("big-endian", (bar() + _AWAY).astype(">f4"))):
        yield ObjectCase(name, _cloud(xyz), "ok", "ok", across())


def _grasps() -> Iterator[ObjectCase]:
    cloud = _cloud(bar() + _AWAY)
    fine = across()
    for name, grasp, reason in (
        ("along the axis", across(0.16, axis=0), "ok"),
        ("1 nm wide", across(1e-9), "ok"),
        ("denormal width", Grasp(_AWAY * [0, 1, 1] + [5e-324, 0, 0], _AWAY * [0, 1, 1], np.eye(3)), "ok"),
        ("1 m wide", across(1.0), "more than max_width_m"),
        ("50 m off", across(middle=_AWAY + np.array([0.0, 50.0, 0.0])), "more than max_distance_m"),
        (
            "1e160 m off",
            across(middle=_AWAY + np.array([0.0, 1e160, 0.0]), width_m=1e150),
            "max_width_m|max_distance_m",
        ),
        ("1e300 m wide", across(1e300), "more than max_width_m"),
        ("left-handed", Grasp(fine.g1, fine.g2, fine.rotation @ np.diag([1.0, 1.0, -1.0])), "not a rotation matrix"),
        ("scaled rotation", Grasp(fine.g1, fine.g2, 1e300 * fine.rotation), "not a rotation matrix"),
        ("zero rotation", Grasp(fine.g1, fine.g2, np.zeros((3, 3))), "not a rotation matrix"),
    ):
        yield ObjectCase(f"grasp {name}", cloud, "ok", reason, grasp)


def _tables() -> Iterator[ObjectCase]:
    cloud = _cloud(bar() + _AWAY)
    for name, coefficients, planned in (
        ("from above", (0.0, 0.0, 1.0, -1.27), "ok"),
        ("from below", (0.0, 0.0, -1.0, 1.27), "ok"),
        ("steep", (0.0, -0.95, -0.312, 0.5), "ok"),
        ("vertical", (0.0, 1.0, 0.0, 0.0), "ok"),
        ("behind the camera", (0.0, 0.0, 1.0, 1.27), "plane: .* is behind the camera"),
        ("1e9 m away", (0.0, 0.0, 1.0, -1e9), "plane: .* more than max_range_m"),
        ("denormal offset", (0.0, 0.0, 1.0, -5e-324), "ok"),
    ):
        yield ObjectCase(f"table {name}", cloud, planned, "ok", across(), Plane.from_coefficients(coefficients))


def _turn() -> Float64:
    angle = 0.7
    return np.array([[np.cos(angle), -np.sin(angle), 0.0], [np.sin(angle), np.cos(angle), 0.0], [0.0, 0.0, 1.0]])


def scene(tilt: float = 0.6, rise: float = 0.05, width: int = 320, height: int = 240) -> Float32:
    """(H, W, 3): a table, tilted by `tilt` rad about x, with a box of `rise` [m] height."""
    focal = 0.75 * width
    u, v = np.meshgrid((np.arange(width) - width / 2) / focal, (np.arange(height) - height / 2) / focal)
    rays = np.stack([u, v, np.ones_like(u)], axis=-1)
    normal = np.array([0.0, -np.sin(tilt), -np.cos(tilt)])
    depth = 0.9 * np.cos(tilt) / -(rays @ normal)
    box = (np.abs(u - 0.05) < 0.06) & (np.abs(v) < 0.06)
    depth = np.where(box, (0.9 * np.cos(tilt) - rise) / -(rays @ normal), depth)
    depth[(depth < 0.0) | (depth > 4.0)] = np.nan
    return np.asarray(rays * depth[..., None], np.float32)


def scene_cases() -> Iterator[SceneCase]:
    """Clouds of whole scenes, as images and as lists of points."""
    for name, change, status, reason in _scenes():
        xyz = change(scene())
        yield SceneCase(f"{name}, image", Cloud(xyz), status, reason)
        yield SceneCase(f"{name}, list", Cloud(xyz.reshape(-1, 3)), status, reason)
    image = scene()
    shuffled = np.random.default_rng(0).permutation(image.reshape(-1, 3)).reshape(image.shape)
    yield SceneCase("shuffled pixels", Cloud(shuffled), "bad_cloud", "beside the rays")
    large = scene(width=1280, height=800)  # 1,024,000 points
    yield SceneCase("a million points, image", Cloud(large), "ok")
    yield SceneCase("a million points, list", Cloud(large.reshape(-1, 3)), "ok")
    for tilt in (0.0, 1.0, 1.3):
        yield SceneCase(f"table at {tilt} rad", Cloud(scene(tilt)), "ok")
    yield SceneCase("bare table", Cloud(scene(rise=0.0)), "no_object", "nothing stands more")
    for n in range(4):
        yield SceneCase(f"{n} points in a list", _cloud(bar()[:n].reshape(-1, 3) + _AWAY), *_few_status(n))
    yield SceneCase("only a ball", _cloud(ball(5000) + _AWAY), "no_plane", "plane holds|narrow")
    yield SceneCase(
        "only a line", _cloud(np.outer(np.linspace(0.5, 1.0, 900), [0.1, 0.1, 1.0])), "no_plane", "collinear|narrow"
    )


def _few_status(n: int) -> tuple[str, str]:
    return ("empty_cloud", "no point") if n == 0 else ("too_few_points", "points in range, fewer than")


def _scenes() -> Iterator[tuple[str, Callable[[Float32], Float32], str, str]]:
    def damaged(value: float, axis: int, step: int = 0) -> Callable[[Float32], Float32]:
        def change(xyz: Float32) -> Float32:
            flat = xyz.reshape(-1, 3)
            index = np.flatnonzero(np.isfinite(flat[:, 2]))
            some = np.random.default_rng(5).permutation(index)[: len(index) // step] if step else index[len(index) // 2]
            flat[some, axis] = np.float32(value)
            return xyz

        return change

    def scaled(factor: float) -> Callable[[Float32], Float32]:
        return lambda xyz: (xyz.astype(np.float64) * factor).astype(np.float32)

    yield "as it is", scaled(1.0), "ok", ""
    for axis in (0, 1):
        for value in (1e10, 1e20, -3e38, np.inf, np.nan):
            yield f"one {'xy'[axis]} of {value:g}", damaged(value, axis), "ok", ""
            yield f"5 % of {'xy'[axis]} {value:g}", damaged(value, axis, 20), "ok", ""
    for value in (np.inf, -np.inf, np.nan, 0.0, -1.0, 3e38, 1e-42):
        yield f"5 % of z {value:g}", damaged(value, 2, 20), "ok", ""
    for exponent in (-9, -3, 3):
        yield f"scaled by 1e{exponent}", scaled(10.0**exponent), "empty_cloud", "no point between 0.16 and 2 m"
    yield "denormal", scaled(1e-42), "empty_cloud", "no point between"
    yield "only NaN", scaled(float("nan")), "empty_cloud", "is finite"
    yield "all x 1e20", damaged(1e20, 0, 1), "bad_cloud", "beside the rays|field of view|field_of_view"
    yield "10 km away", lambda xyz: xyz + np.float32(1e4), "empty_cloud", "no point between"
    yield "behind the camera", lambda xyz: -xyz, "unknown_frame", "not_optical: 100% of the points are at z <= 0"
    yield "in the frame of the link", _to_link, "unknown_frame", "not_optical: .* in view along x"


def _to_link(xyz: Float32) -> Float32:
    """From x right, y down, z forward to x forward, y left, z up."""
    return np.ascontiguousarray(np.stack([xyz[..., 2], -xyz[..., 0], -xyz[..., 1]], axis=-1))
