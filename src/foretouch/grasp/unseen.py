# SPDX-License-Identifier: Apache-2.0
"""Pixels without depth in the way of a finger: glass, black and shiny parts, and what the image does not show.

What the camera has not measured is not free. A contact beside such pixels may be in the middle of the object. Beside nearly every
object there is a band without depth, too, where one of the two lenses (or the projector) does not see the background: it is as
wide as the baseline times the share by which the background is farther. So much is expected, and does not count.
"""

from dataclasses import dataclass
from typing import Final, Self

import numpy as np

from foretouch.types import Cloud, Float64
from foretouch.types.scene import Object

BESIDE_UNSEEN: Final = "beside_unseen"
"""Flag of a grasp with a contact beside pixels without depth, which may belong to the object."""

_REACH_M: Final = 0.06  # outwards from a contact
_STEPS: Final = 30  # in which that is looked at
_BASELINE_M: Final = 0.1  # of the widest stereo camera for tables
_BEHIND_M: Final = 0.005  # behind a place, from where on the camera sees through it
_SPARE_M, _SPARE_PIXELS = 0.008, 2.0  # of a band that are expected, too: edges have no depth
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
        x, y, z = target.cloud.xyz[few].T.astype(np.float64)
        row, column = np.divmod(target.pixels[few], target.image_shape[1])
        camera = []
        for ray, at in ((x / z, column), (y / z, row)):
            centred = ray - ray.mean()
            spread = float(centred @ centred)
            if not spread > 0.0:
                return None
            focal = float(centred @ at) / spread
            camera.append((focal, float(at.mean()) - focal * float(ray.mean())))
        return cls(target.image, np.array(camera))

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
        z, (across, down) = way[..., 2], self.camera
        columns = np.rint(way[..., 0] / z * across[0] + across[1]).astype(np.intp)
        rows = np.rint(way[..., 1] / z * down[0] + down[1]).astype(np.intp)
        depth = self.image.depths(rows, columns)
        nothing = np.isnan(depth)
        through = depth > z + _BEHIND_M  # also what is out of view
        number = np.arange(_STEPS)
        first = np.where(nothing.any(axis=1), nothing.argmax(axis=1), _STEPS)
        first = np.where(np.where(through.any(axis=1), through.argmax(axis=1), _STEPS) < first, _STEPS, first)
        behind = ~nothing & (number > first[:, None])
        last = np.where(behind.any(axis=1), behind.argmax(axis=1), _STEPS)
        row, start = np.arange(len(way)), np.minimum(first, _STEPS - 1)
        near, far = z[row, start], depth[row, np.minimum(last, _STEPS - 1)]
        expected = np.where(last < _STEPS, _BASELINE_M * np.abs(1.0 - near / far), 0.0)
        expected += _SPARE_M + _SPARE_PIXELS * near / across[0]
        return np.where(first < _STEPS, np.maximum((last - first) * step_m - expected, 0.0), 0.0)

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
