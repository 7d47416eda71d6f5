# SPDX-License-Identifier: Apache-2.0
"""Drop points that no depth camera can measure: beside the ray of their pixel, or out of the field of view.

A depth camera moves a point along the ray of its pixel and never aside, so x/z and y/z of an image are affine
functions of column and row. One damaged coordinate with a sound depth may be 1e20 m away and outweigh all other
points in a least-squares fit, hence such points are dropped before the table and the objects are estimated.
"""

import math

import numpy as np

from foretouch.cloud.geometry.columns import spread
from foretouch.cloud.geometry.frames import FIELD_OF_VIEW_DEG, TANGENT
from foretouch.types import Bool, Float32, Float64, Index

_FITTED = 128  # points that the rays are fitted to
_DEVIATION = 0.05  # distance of a point from the ray of its pixel, per depth, beyond which it is dropped
_MAX_OFF = 0.5  # share of points beside their rays, or out of view, beyond which the whole cloud is refused
_NO_SLOPE = 1e-7  # per column or row: less than the rounding of a point
_TRIALS = 128  # triples of pixels: if half of them are damaged, all triples are with probability 4e-8


class RayFilter:
    """Finds the points of an image that are beside the ray of their pixel.

    Args:
        sample: (n, 3) float32 [m], points of the image with a positive depth.
        rows: (n,) their rows.
        columns: (n,) their columns.
    """

    def __init__(self, sample: Float32, rows: Index, columns: Index) -> None:
        pixels = np.ones((len(rows), 3))
        pixels[:, 1], pixels[:, 2] = columns, rows
        rays = _fit_rays(sample, pixels)
        slopes = rays.T.copy()
        slopes[:, 1:][np.abs(slopes[:, 1:]) <= _NO_SLOPE] = 0.0
        # (7,) the largest deviation, and for x/z and y/z: at the first pixel, per column, per row
        self.numbers = [float(np.float32(_DEVIATION)), *slopes.ravel().tolist()]
        self.dropped: list[Index] = []  # flat indices in the image, to be appended to; a point counts once
        self.off_sample = self.beside(sample, rows, columns)  # (n,) bool
        self.reason = ""  # why the image as a whole is not usable
        share = np.count_nonzero(self.off_sample) / max(len(rows), 1)
        widest = float(np.abs(pixels @ rays).max(initial=0.0))
        if share > _MAX_OFF:
            self.reason = (
                f"{share:.0%} of the points are beside the rays of their pixels, more than {_MAX_OFF:.0%}: "
                "is the cloud an image in the optical frame?"
            )
        elif widest > TANGENT:
            angle = 2.0 * math.degrees(math.atan(widest))
            self.reason = f"rays: {angle:.0f} degrees is more than a field of view of {FIELD_OF_VIEW_DEG:g}"

    def beside(self, xyz: Float32, rows: Index, columns: Index) -> Bool:
        """Return (...) bool: whether points (..., 3) with a positive depth are beside their ray; false where one number is NaN."""
        deviation, *slopes = self.numbers
        z, apart = xyz[..., 2], []
        with np.errstate(invalid="ignore", over="ignore"):
            for axis, (first, by_column, by_row) in enumerate((slopes[:3], slopes[3:])):
                tangent = np.asarray(first + by_column * columns + by_row * rows, np.float32)
                apart.append(np.abs(xyz[..., axis] - tangent * z))
            return np.asarray((np.maximum(*apart) > z * np.float32(deviation)) & (z > 0.0), np.bool_)

    def count_dropped(self, xyz: Float32) -> int:
        """Return the number of dropped points of the image (H, W, 3) with three finite coordinates."""
        if not self.dropped:
            return 0
        pixels = np.unique(np.concatenate(self.dropped))
        return int(np.count_nonzero(finite_rows(xyz.reshape(-1, 3)[pixels])))


def out_of_view(xyz: Float32) -> Bool:
    """Return (N,) bool: points (N, 3) float32 [m] with a positive depth that are out of the field of view, or not finite."""
    z = xyz[:, 2]
    with np.errstate(invalid="ignore", over="ignore"):
        reach = z * np.float32(TANGENT)
        off = ~((np.abs(xyz[:, 0]) <= reach) & (np.abs(xyz[:, 1]) <= reach))
        return np.asarray(off & (z > 0.0) & np.isfinite(z), np.bool_)


def view_fault(off: int, usable: int) -> str:
    """Return why a list of points is not usable, by those of the usable ones that are out of view; "" if it is."""
    if off <= _MAX_OFF * usable:
        return ""
    return f"{off} of {usable} points are out of a field of view of {FIELD_OF_VIEW_DEG:g} degrees"


def finite_rows(points: Float32) -> Bool:
    """Return (n,) bool: points (n, 3) with three finite coordinates; reductions along rows of three are slow."""
    x, y, z = np.isfinite(points).T
    return np.asarray(x & y & z, np.bool_)


def _fit_rays(sample: Float32, pixels: Float64) -> Float64:
    """Return (3, 2) float64: x/z and y/z for 1, column and row. Robust: up to about half of the points may be damaged."""
    usable = np.flatnonzero(finite_rows(sample))
    if len(usable) > _FITTED:
        usable = usable[spread(len(usable), _FITTED)]
    points, pixels = sample[usable].astype(np.float64), pixels[usable]
    tangents = points[:, :2] / points[:, 2:]
    rays = _least_squares(pixels, tangents)
    if _inliers(pixels, tangents, rays).all():
        return rays
    rng = np.random.default_rng(0)
    best = np.zeros(len(usable), np.bool_)
    for triple in rng.integers(len(usable), size=(_TRIALS, 3)):
        inliers = _inliers(pixels, tangents, _least_squares(pixels[triple], tangents[triple]))
        if inliers.sum() > best.sum():
            best = inliers
    return _least_squares(pixels[best], tangents[best]) if best.any() else rays


def _inliers(pixels: Float64, tangents: Float64, rays: Float64) -> Bool:
    return np.asarray((np.abs(pixels @ rays - tangents) <= _DEVIATION).all(axis=1), np.bool_)


def _least_squares(pixels: Float64, tangents: Float64) -> Float64:
    if len(pixels) == 0:
        return np.zeros((3, 2))
    # Pixels are small whole numbers: the normal equations are as exact as needed, in a fraction of the time of lstsq.
    values, vectors = np.linalg.eigh(pixels.T @ pixels)
    inverse = np.where(
        values > 1e-12 * values[-1], 1.0 / np.maximum(values, 1e-300), 0.0
    )  # 0 if pixels are on one line
    return np.asarray((vectors * inverse) @ (vectors.T @ (pixels.T @ tangents)), np.float64)
