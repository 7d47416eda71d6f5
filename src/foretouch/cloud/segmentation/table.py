# SPDX-License-Identifier: Apache-2.0
"""Which plane of a cloud is the table that carries the objects, and whether to trust it.

The plane with most points is the table, unless the image speaks against it:

- A table is solid. A plane through a rim and a rail has points below it amid its own: they were
  seen through it.
- The top of a box has most points below it and carries nothing.
- The floor of a bin has things that rise from it on all sides; its walls end at the rim or at the image.
- A table that stands on the floor is above it, level with it, and wider than an object.

What is left is looked for again in thinner slabs where its points deviate too much, and doubted if that does not help either.
"""

import math
from collections.abc import Iterator
from dataclasses import replace
from functools import cached_property

import numpy as np

from foretouch.cloud.segmentation.clusters import NOISE_FACTOR
from foretouch.cloud.segmentation.plane import PlaneConfig, PlaneFit, fit_plane
from foretouch.types import Bool, Float32, Plane

_THINNER = (0.7, 0.5)  # of the threshold of the plane
_ABOVE_M, _PARALLEL = 0.1, math.cos(math.radians(15.0))  # a table stands above the floor, and level
_WIDE_M = 0.6 / math.sqrt(12.0)  # standard deviation of points along .6 m, which no object exceeds
_MOST_PLANES = 6
_BELOW_M = 0.03  # deeper than the noise of a table
_THROUGH = 0.25  # of the points on a plane are below it amid them: 0.05 at most of tables, 0.7 and more of rims
_AMID = 7  # of 8 sectors of the image around such a point have points of the plane, so that it is not between a table and a chair
_STRAY = 0.01  # of these, fewer in a sector are others'
_SOME = 160  # points that are looked at
_BARE = 0.003  # of the points on a plane, fewer stand on it: nothing does
_DOMINANT = 0.4  # of all points are on no wall of a bin whose floor is in view
_WALLED = 0.4  # of the directions, things rise beyond a wall of a bin in half of them
_ENCLOSED = 0.8  # of the points beyond an end rise from the plane
_TURNS = np.arange(16, dtype=np.float32) * np.float32(math.pi / 8.0)
_SIDES = np.stack([np.cos(_TURNS), np.sin(_TURNS)], axis=1)  # directions in the image (16, 2)
_END = 0.02  # of the points of a plane are farther off in a direction: single ones are others'


class _View:
    """How the points of an image (N, 3) lie about a plane."""

    def __init__(self, xyz: Float32, fit: PlaneFit, plane: Plane, threshold_m: float, one_view: bool) -> None:
        self.fit, self.xyz, self.plane, self.threshold_m, self.one_view = fit, xyz, plane, threshold_m, one_view
        self.height = plane.height(xyz)
        self.on, self.below = np.abs(self.height) < threshold_m, self.height < -_BELOW_M
        self.count = int(np.count_nonzero(self.on))
        self.share = self.count / len(xyz)

    @property
    def noise_m(self) -> float:
        """Height up to which points belong to the plane at its mean depth [m]."""
        return (
            NOISE_FACTOR
            * self.fit[1]
            * float(np.add.reduce(self.xyz[:, 2][self.on], dtype=np.float64) / self.count) ** 2
        )

    @cached_property
    def ends(self) -> Float32:
        """How far the plane reaches in each direction of the image (16, 1), at a depth of 1."""
        last = self.count - 1 - int(_END * self.count)
        return np.partition(_directed(self.xyz[self.on]), last, axis=1)[:, last, None]

    def within(self, xyz: Float32) -> Bool:
        """Return (N,) which points are seen within the outline of the plane."""
        return np.asarray((_directed(xyz) <= self.ends).all(axis=0) & (xyz[:, 2] > 0.0), np.bool_)

    @cached_property
    def seen_through(self) -> float:
        """How many points below it are amid its points in the image, by their number; 0 where several cameras saw them."""
        if not self.one_view or np.count_nonzero(self.below) <= _THROUGH * self.count:
            return 0.0
        below = self.xyz[self.below]
        below = below[self.within(below)]
        some, on = (_rays(xyz[:: max(1, len(xyz) // _SOME)]) for xyz in (below, self.xyz[self.on]))
        turn = np.arctan2(*np.moveaxis(on - some[:, None], -1, 0))
        sector = np.floor(turn * (4.0 / math.pi)).astype(np.intp) % 8 + 8 * np.arange(len(some))[:, None]
        sides = np.bincount(sector.ravel(), minlength=8 * len(some)).reshape(-1, 8) > _STRAY * len(on)
        return float(np.mean(sides.sum(axis=1) >= _AMID)) * len(below) / self.count if len(some) else 0.0

    @property
    def is_seen_through(self) -> bool:
        """Whether so many points are below it, amid its points, that it is not solid."""
        return self.seen_through > _THROUGH

    @property
    def is_bare_top(self) -> bool:
        """Whether most points are below it and none stand on it."""
        if 2 * np.count_nonzero(self.below) < len(self.below):
            return False
        above = self.height > self.threshold_m
        feet = self.xyz[above] - np.outer(self.height[above], self.plane.normal).astype(np.float32)
        return bool(np.count_nonzero(self.within(feet)) < _BARE * self.count)

    @property
    def enclosed(self) -> float:
        """Share of the directions in which others rise from it beyond its end."""
        beyond = _directed(self.xyz) > self.ends
        rising = beyond & (self.height > self.threshold_m)
        return float(np.mean(rising.sum(axis=1) > _ENCLOSED * beyond.sum(axis=1)))


def find_table(xyz: Float32, config: PlaneConfig, *, one_view: bool = True) -> PlaneFit:
    """Fit the plane that carries the objects, by the rule of `PlaneConfig.table`.

    Args:
        xyz: (N, 3) float32 [m], finite, camera optical frame.
        config: The rule and thresholds; the same input gives bit-equal results.
        one_view: All points are seen from the origin, so that what is below a table within its outline was seen through it.

    Returns:
        The fit, or the reason why there is none (see `fit_plane`). With a plane, a reason says why not to trust it.
    """
    if config.table == "given":
        return _given(xyz, config)
    first = fit_plane(xyz, config)
    if first[0] is None:
        return first
    if config.table != "largest":
        return _chosen(xyz, first, config)
    table = _carrying(xyz, first, config, one_view)
    for share in _THINNER if table[2] else ():
        thinner = replace(config, threshold_m=max(share * config.threshold_m, 0.001))
        again = _carrying(xyz, fit_plane(xyz, thinner), thinner, one_view)
        if again[0] is not None and not again[2]:
            return again
    return table


def _given(xyz: Float32, config: PlaneConfig) -> PlaneFit:
    """Return the given plane, and its noise where enough points are on it, else 0."""
    plane = Plane.from_coefficients(config.coefficients).towards_camera
    points = _near_points(xyz, plane, config)
    if len(points) < config.min_fraction * len(xyz):
        return plane, 0.0, ""
    scaled = (points @ plane.normal + plane.offset) / points[:, 2].astype(np.float64) ** 2
    return plane, math.sqrt(float(np.mean(scaled * scaled))), ""


def _chosen(xyz: Float32, first: PlaneFit, config: PlaneConfig) -> PlaneFit:
    """Return the plane that is nearest to the camera, or to a point."""
    fits = [first, *_others(xyz, first, config, config.min_fraction)]
    planes = [plane for plane, *_ in fits if plane is not None]
    if config.table == "point":
        apart = [abs(float(np.dot(plane.normal, config.point)) + plane.offset) for plane in planes]
    else:
        apart = [float(np.median(_near_points(xyz, plane, config)[:, 2])) for plane in planes]
    return fits[int(np.argmin(apart))]


def _carrying(xyz: Float32, first: PlaneFit, config: PlaneConfig, one_view: bool) -> PlaneFit:
    """Return the plane with most points that may be a table, with a reason where it is doubted; the first may be none."""
    view = _view(xyz, first, config, one_view)
    if view is None:
        return first
    not_solid = view.is_seen_through
    if not_solid or view.is_bare_top or (view.share < _DOMINANT and _WALLED <= view.enclosed < 1.0):
        others = [_view(xyz, fit, config, one_view) for fit in _others(xyz, first, config, config.min_fraction / 2.0)]
        tables = [
            other for other in others if other is not None and not other.is_seen_through and not other.is_bare_top
        ]
        better = [other for other in tables if other.enclosed == 1.0 and other.share >= config.min_fraction / 2.0]
        if not_solid or view.is_bare_top:
            better += [other for other in tables if other.share >= config.min_fraction]
        view = next(iter(better), view)
    view = _wide_above(xyz, view, config)
    return view.fit[0], view.fit[1], _why_doubtful(view, config)


def _why_doubtful(view: _View, config: PlaneConfig) -> str:
    """Return why not to trust a plane, and what to set; "" for a table."""
    cure = "set segmentation.plane.table to point, with plane.point on the table, or to given, with plane.coefficients"
    if view.is_seen_through:
        what = f"amid its points {view.seen_through:.0%} as many are below it as on it"
        return f"the largest plane is no table: {what}; {cure}"
    if view.noise_m > config.max_noise_m:
        what = f"the points of the table deviate from a plane by up to {view.noise_m * 1e3:.0f} mm"
        return f"{what}, more than {config.max_noise_m * 1e3:g} mm (segmentation.plane.max_noise_m): lower objects are not seen; raise it, or {cure}"
    return ""


def _others(xyz: Float32, first: PlaneFit, config: PlaneConfig, least: float) -> Iterator[PlaneFit]:
    """Iterate over the planes in what is off the planes before, while it is at least a share of all points."""
    rest, plane = xyz, first[0]
    for _ in range(_MOST_PLANES - 1):
        if plane is None:
            return
        rest = rest[np.abs(rest @ plane.normal + plane.offset) > 2.0 * config.threshold_m]
        if len(rest) < least * len(xyz):
            return
        fit = fit_plane(rest, config)
        yield fit
        plane = fit[0]


def _wide_above(xyz: Float32, low: _View, config: PlaneConfig) -> _View:
    """Return a plane above another one, parallel to it and wider than an object, as a table above the floor; else that one."""
    high = low.height > _ABOVE_M
    if np.count_nonzero(high) < config.min_fraction * len(xyz):
        return low
    view = _view(xyz, fit_plane(xyz[high], config), config, low.one_view)
    if view is None or view.plane.normal @ low.plane.normal < _PARALLEL or view.share < config.min_fraction:
        return low
    wide = np.linalg.eigvalsh(np.cov(xyz[view.on].T))[2] > _WIDE_M**2
    return view if wide and not view.is_seen_through else low


def _view(xyz: Float32, fit: PlaneFit, config: PlaneConfig, one_view: bool) -> _View | None:
    """Return how points lie about the plane of a fit; None if there is none, or none is on it."""
    view = None if fit[0] is None else _View(xyz, fit, fit[0], config.threshold_m, one_view)
    return view if view is not None and view.count else None


def _near_points(xyz: Float32, plane: Plane, config: PlaneConfig) -> Float32:
    return xyz[np.abs(xyz @ plane.normal + plane.offset) < config.threshold_m]


def _directed(xyz: Float32) -> Float32:
    """Return (16, N) how far points are off the optical axis in each direction of the image, at a depth of 1."""
    return np.asarray(_SIDES @ _rays(xyz).T, np.float32)


def _rays(xyz: Float32) -> Float32:
    """Return (N, 2) where the camera sees points, at a depth of 1."""
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        return xyz[:, :2] / xyz[:, 2:]
