# SPDX-License-Identifier: Apache-2.0
"""Pixels without depth in the way of a finger: glass, black and shiny parts, and what the image does not show.

What the camera has not measured is not free. A contact beside such pixels may be in the middle of the object. Beside nearly every
object there is a band without depth, too, where one of the two lenses (or the projector) does not see the background: it is as
wide as the baseline times the share by which the background is farther. So much is expected, and does not count.
"""

from dataclasses import dataclass
from typing import Final, Self

import numpy as np

from foretouch.types import Bool, Cloud, Float32, Float64, Index, Int64
from foretouch.types.scene import Object

BESIDE_UNSEEN: Final = "beside_unseen"
"""Flag of a grasp with a contact beside pixels without depth, which may belong to the object."""

_REACH_M: Final = 0.06  # outwards from a contact
_STEPS: Final = 30  # in which that is looked at
_BASELINE_M: Final = 0.1  # of the widest stereo camera for tables
_BEHIND_M: Final = 0.005  # behind a place, from where on the camera sees through it
_SPARE_M, _SPARE_PIXELS = 0.008, 2.0  # of a band that are expected, too: edges have no depth
_BEYOND: Final = np.arange(1.0, 4.0)  # pixels beyond the last one: of an edge, two mix both depths, one on either side
_STEEP: Final = 2.0  # slope of a surface against the image, from which on its depth counts as an edge
_SAMPLED: Final = 256  # points of an object, of which the projection of the camera follows
_FEWEST: Final = 12  # of them


@dataclass(frozen=True, eq=False)
class DepthAround:
    """The depth image around an object."""

    image: Cloud  # organised
    camera: Float64  # (2, 2) float64, focal length and principal point across and down [px]

    @classmethod
    def of(cls, target: Object) -> Self | None:
        """Find the camera of an object's image from its points; None where the image is not known.

        Args:
            target: The object.
        """
        if target.image is None or target.image_shape is None or len(target.pixels) < _FEWEST:
            return None
        few = slice(None, None, max(1, len(target.pixels) // _SAMPLED))
        xyz, pixels, width = target.cloud.xyz[few].astype(np.float64), target.pixels[few], target.image_shape[1]
        rays, row = xyz[:, :2].T / xyz[:, 2], pixels // width
        at = np.array([pixels - width * row, row], np.float64)
        ray, place = rays.mean(axis=1), at.mean(axis=1)
        centred = rays - ray[:, None]
        spread = (centred * centred).sum(axis=1)
        if not (spread > 0.0).all():
            return None
        focal = (centred * at).sum(axis=1) / spread
        return cls(target.image, np.stack([focal, place - focal * ray], axis=1))

    def beyond_m(self, contacts: Float64, outwards: Float64) -> Float64:
        """Measure how far pixels without depth reach outwards from contacts, beyond what is expected beside any object.

        Args:
            contacts: (N, 3) float64 [m], camera frame.
            outwards: (N, 3) float64 of unit length, from which the finger comes.

        Returns:
            (N,) float64 [m], 0 where the camera sees through the way of the finger, or what is in front of it, or nothing.
        """
        step_m = _REACH_M / _STEPS
        way = contacts[:, None] + np.arange(_STEPS)[:, None] * step_m * outwards[:, None]
        z, across, depth = way[..., 2], self.camera[0], self._depths(way)
        nothing = np.isnan(depth)
        stopped = nothing | (depth > z + _BEHIND_M)  # or seen through, also what is out of view
        row, first = np.arange(len(way)), stopped.argmax(axis=1)
        unseen = nothing[row, first]
        if not unseen.any():
            return np.zeros(len(way))
        behind = ~nothing & (np.arange(_STEPS) > first[:, None])
        last = np.where(behind.any(axis=1), behind.argmax(axis=1), _STEPS)
        near, far = z[row, first], depth[row, np.minimum(last, _STEPS - 1)]
        expected = np.where(last < _STEPS, _BASELINE_M * np.abs(1.0 - near / far), 0.0)
        expected += _SPARE_M + _SPARE_PIXELS * near / across[0]
        return np.where(unseen, np.maximum((last - first) * step_m - expected, 0.0), 0.0)

    def _depths(self, places: Float64) -> Float32:
        """Return the depth [m] in the pixels of places (..., 3); NaN where there is none, and infinity out of view."""
        return self.image.depths(*self._pixels(places))

    def _pixels(self, places: Float64) -> tuple[Index, Index]:
        """Return row and column of places (..., 3)."""
        (f_x, c_x), (f_y, c_y) = self.camera.tolist()
        z = places[..., 2]
        rows = np.rint(places[..., 1] / z * f_y + c_y).astype(np.intp)
        return rows, np.rint(places[..., 0] / z * f_x + c_x).astype(np.intp)

    def pixel_m(self, depth_m: float) -> float:
        """Return the width of a pixel at a depth [m]."""
        return depth_m / float(np.abs(self.camera[:, 0]).mean())

    def edges(self, last: Float64, outwards: Float64, own: Bool) -> tuple[Bool, Int64]:
        """Find which points are on the outline of an object, and how many pixels beyond them are neither its own nor of the background.

        Args:
            last: (..., 3) float64 [m], points of the object, camera frame.
            outwards: (..., 3) float64 of unit length.
            own: (H, W) bool, pixels of the object.

        Returns:
            (...) bool, whether the next pixel is not the object's; and (...) int64 number of pixels, 2 at most.
        """
        step_m = self.pixel_m(float(last[..., 2].mean()))
        rows, columns = self._pixels(last[..., None, :] + _BEYOND[:, None] * step_m * outwards[..., None, :])
        depth = self.image.depths(rows, columns)
        with np.errstate(invalid="ignore"):  # of two pixels out of view
            settled = np.abs(depth[..., 1:] - depth[..., :-1]) < _BEHIND_M + _STEEP * step_m
        first, second = ~settled[..., 0], ~settled[..., 1]
        seen = own.reshape(-1).take(rows * own.shape[1] + columns, mode="clip")  # also what is out of view
        return ~seen.all(axis=-1), first * (1 + second)

    def beside(self, g1: Float64, g2: Float64) -> Float64:
        """Measure the same of grasps, at the contact where it is farther.

        Args:
            g1: (K, 3) float64 [m], one contact of each.
            g2: (K, 3) float64 [m], the other.

        Returns:
            (K,) float64 [m].
        """
        along = (g2 - g1) / np.linalg.norm(g2 - g1, axis=1)[:, None]
        beyond = self.beyond_m(np.concatenate([g1, g2]), np.concatenate([-along, along]))
        return np.asarray(beyond.reshape(2, -1).max(axis=0), np.float64)
