# SPDX-License-Identifier: Apache-2.0
"""Fit the dominant plane of a cloud, the table.

RANSAC (Fischler and Bolles 1981) over a few thousand points, with the hypotheses of a batch scored in one
matrix product, then two least-squares refits in float64. It stops once a better plane is improbable.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal, get_args

import numpy as np

from foretouch.cloud.geometry.columns import centred_columns
from foretouch.config import Settings, setting
from foretouch.errors import ConfigError
from foretouch.kernels import Kernel
from foretouch.types import Float32, Float64, Index, Plane

_count_near = Kernel("count_near")
_points_near = Kernel("points_near")
_residuals_near = Kernel("residuals_near")

_SCORED = 512  # points that score a hypothesis
_REFIT = 4096  # points of the final fit
_BATCH = 64  # hypotheses scored at once
_Rows = Index | slice

TableMode = Literal["largest", "nearest", "point", "given"]

_MISS = 1e-4  # accepted probability that no sample of three was on the plane
_MIN_PEAK = 0.6  # of the points within three thresholds, within one: a blob has 0.3 to 0.5, a table almost 1
_MIN_SPREAD_M = 0.02  # least standard deviation of the table's points along its narrow side
_MAX_TRIALS = 1024  # RANSAC samples
_FULL_REACH_M = (
    0.6  # nearer than this the threshold falls with the square of the depth, as the noise of a stereo camera
)
_THINNER = (1.0, 0.5, 0.25)  # of the threshold: a table full of things stands out in a thinner slab only
_LEAST_REACH_M = 0.002  # threshold of all
_SEED = 0  # of the samples: the same points give the same plane


@dataclass(frozen=True, kw_only=True)
class PlaneConfig(Settings):
    """Settings of the plane fit, and which planes are not a table."""

    table: TableMode = setting(
        "largest",
        "The plane with most points, but for walls, rims and floors (see segmentation); the nearest to the camera; the one at a point; or the given one",
        choices=get_args(TableMode),
    )
    point: tuple[float, ...] = setting((), "x, y, z on the table for table point, in the cloud's frame", unit="m")
    coefficients: tuple[float, ...] = setting(
        (), "a, b, c, d of the plane ax+by+cz+d=0 for table given, in the cloud's frame", unit="m"
    )
    threshold_m: float = setting(
        0.01,
        "Points closer than this belong to a plane; nearer than 0.6 m less, with the square of the depth",
        bounds=(0.001, 0.1),
    )
    min_fraction: float = setting(0.2, "Minimum fraction of the points on the table", bounds=(0.01, 1.0))
    max_noise_m: float = setting(
        0.01,
        "The table is doubted if its points deviate from it by more, as 2.5 standard deviations: what is lower is not seen",
        bounds=(0.001, 0.1),
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, values, mode, wanted in (
            ("point", self.point, "point", "x, y, z"),
            ("coefficients", self.coefficients, "given", "a, b, c, d"),
        ):
            if len(values) != len(wanted.split()) * (self.table == mode):
                raise ConfigError(
                    f"{name}: {len(values)} numbers: table {mode} needs {wanted}, and table {self.table} {'them' if self.table == mode else 'none'}"
                )


PlaneFit = tuple[Plane | None, float, str]
"""The dominant plane, its normal towards the camera, or None; the s of the stereo noise sigma = s·z² [1/m], measured along the
normal on its points; and why there is no plane, else ""."""


def fit_plane(xyz: Float32, config: PlaneConfig) -> PlaneFit:
    """Fit the plane with the most points.

    Args:
        xyz: (N, 3) float32 [m], finite, camera optical frame.
        config: Thresholds; the same input gives bit-equal results.

    Returns:
        The fit, or the reason why there is none: too few points, all coinciding or collinear, a blob.
    """
    if len(xyz) < 3:
        return None, 0.0, f"{len(xyz)} points span no plane"
    fitted, some, _ = _first_draws(len(xyz))
    # Centred, so that scoring in float32 stays exact far from the origin.
    origin, columns, _ = centred_columns(xyz[fitted].astype(np.float64))
    points = np.ascontiguousarray(columns.T)
    scored = points[some].astype(np.float32)
    near = min(1.0, abs(float(origin[2])) / _FULL_REACH_M)
    fits: list[PlaneFit] = []
    for share in _THINNER:
        reach = max(config.threshold_m * near * near * share, _LEAST_REACH_M)
        best = _ransac(scored, reach, _batches(len(xyz)))
        if best is None:
            return None, 0.0, "all points coincide or are collinear"
        fits.append(_refit(points, origin, best, reach, config.min_fraction))
        if fits[-1][0] is not None:
            return fits[-1]
    return fits[0]


def _draw(n: int, rng: np.random.Generator) -> tuple[_Rows, _Rows, Index]:
    """Return which of n points are fitted, which of those are scored, and the first batch of triples of those."""
    fitted = _some(n, _REFIT, rng)
    return fitted, _some(min(n, _REFIT), _SCORED, rng), rng.integers(min(n, _SCORED), size=(3, _BATCH))


@lru_cache(maxsize=8)
def _first_draws(n: int) -> tuple[_Rows, _Rows, Index]:
    """`_draw`, once for each n, which nearly all clouds share: drawing anew takes a tenth of the fit."""
    return _draw(n, np.random.default_rng(_SEED))


def _batches(n: int) -> Iterator[Index]:
    """Iterate over batches (3, _BATCH) of triples of the scored points, without end."""
    yield _first_draws(n)[2]
    rng = np.random.default_rng(_SEED)
    _draw(n, rng)
    while True:
        yield rng.integers(min(n, _SCORED), size=(3, _BATCH))


def _some(n: int, count: int, rng: np.random.Generator) -> _Rows:
    """Return at most `count` of n rows, evenly spread over the order, with random offsets: cheap, and independent of scan lines."""
    if n <= count:
        return slice(None)
    return np.asarray((np.arange(count) + rng.random(count)) * (n / count), np.intp)


def _ransac(points: Float32, reach_m: float, batches: Iterator[Index]) -> Float32 | None:
    """Return (4,) float32 a, b, c, d of the hypothesis with most points, None if all are degenerate."""
    best, most, trials = None, 0, 0
    needed: float = _MAX_TRIALS
    while trials < min(needed, _MAX_TRIALS):
        a, b, c = points[next(batches)]
        normals = _cross(b - a, c - a)
        lengths = np.linalg.norm(normals, axis=1)
        usable = lengths > 1e-9
        trials += _BATCH
        if not usable.any():
            continue
        normals = normals[usable] / lengths[usable, None]
        offsets = -np.einsum("ij,ij->i", normals, a[usable])
        counts = _counts(normals @ points.T, offsets, reach_m)
        first = int(counts.argmax())
        if counts[first] > most:
            most = int(counts[first])
            best = np.append(normals[first], offsets[first])
            needed = _trials_needed(most / len(points))
    return best


def _counts(distance: Float32, offsets: Float32, reach_m: float) -> Index:
    """Return (m,) number of points near each plane, from distances (m, n) but for the offsets."""
    counts = np.empty(len(offsets), np.int64)
    _count_near(distance, offsets, *distance.shape, reach_m, counts)
    return counts


def _cross(a: Float32, b: Float32) -> Float32:
    """Cross products of rows (n, 3), in a third of the time of np.cross."""
    (x, y, z), (u, v, w) = a.T, b.T
    return np.stack([y * w - z * v, z * u - x * w, x * v - y * u], axis=1)


def _trials_needed(fraction: float) -> float:
    """Return the number of samples after which all have missed the plane with probability `_MISS`."""
    hit = fraction**3
    return 0.0 if hit >= 1.0 else math.log(_MISS) / math.log1p(-hit)


def _refit(points: Float64, origin: Float64, abcd: Float32, reach_m: float, min_fraction: float) -> PlaneFit:
    """Refit in float64, then check the plane against the limits."""
    normal, offset = abcd[:3].astype(np.float64), float(abcd[3])
    reach, spread = reach_m, 0.0
    for _ in range(2):
        normal, offset, rms, spread = _eigen_plane(_near(points, points @ normal, offset, reach))
        reach = min(reach_m, max(2.5 * rms, 0.001))  # the second fit excludes the base of the objects
    scaled, wide = _residuals(points, points @ normal, offset, reach_m, float(origin[2]))
    inliers = len(scaled)
    reason = _fault(inliers / len(points), inliers / max(wide, 1), spread, min_fraction)
    plane = None if reason else Plane(normal, offset - float(normal @ origin)).towards_camera
    return plane, math.sqrt(scaled @ scaled / max(inliers, 1)), reason


def _near(points: Float64, along: Float64, offset: float, reach: float) -> Float64:
    """Return the points (n, 3) within reach of a plane, from their distances (n,) but for its offset."""
    near, count = np.empty((len(points) + 1, 3)), np.empty(1, np.int64)
    _points_near(points, along, len(points), offset, reach, near, count)
    return near[: count[0]]


def _residuals(points: Float64, along: Float64, offset: float, reach: float, depth_m: float) -> tuple[Float64, int]:
    """Residuals of the points within reach, divided by the square of their depth, and the points within 3 reaches."""
    scaled, counts = np.empty(len(points) + 1), np.empty(2, np.int64)
    _residuals_near(points, along, len(points), offset, reach, depth_m, scaled, counts)
    return scaled[: counts[0]], int(counts[1])


def _eigen_plane(points: Float64) -> tuple[Float64, float, float, float]:
    """Least-squares plane: unit normal, offset, rms distance, and spread along the second axis."""
    centre, _, covariance = centred_columns(points)
    values, vectors = np.linalg.eigh(covariance)
    values = np.sqrt(np.maximum(values, 0.0))
    normal = vectors[:, 0]
    return normal, -float(normal @ centre), float(values[0]), float(values[1])


def _fault(fraction: float, peak: float, spread: float, least: float) -> str:
    if fraction < least:
        return f"the largest plane holds {fraction:.0%} of the points, less than {least:.0%}"
    if spread < _MIN_SPREAD_M:
        return f"the largest plane is {spread * 1e3:.1f} mm wide, less than {_MIN_SPREAD_M * 1e3:g} mm"
    if peak < _MIN_PEAK:
        return f"the largest plane holds {peak:.0%} of the points around it, less than {_MIN_PEAK:.0%}: a blob"
    return ""
