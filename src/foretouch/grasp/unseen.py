# SPDX-License-Identifier: Apache-2.0
"""Pixels without depth in the way of a finger: glass, black and shiny parts, and what the image does not show.

What the camera has not measured is not free. A contact beside such pixels may be in the middle of the object. Beside nearly every
object there is a band without depth, too, where one of the two lenses (or the projector) does not see the background: it is as
wide as the baseline times the share by which the background is farther. So much is expected, and does not count.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final, Self

import numpy as np

from foretouch.kernels import Kernel
from foretouch.types import Cloud, Float64
from foretouch.types.scene import Object

BESIDE_UNSEEN: Final = "beside_unseen"
"""Flag of a grasp with a contact beside pixels without depth, which may belong to the object."""

_unseen_beyond = Kernel("unseen_beyond")

_REACH_M: Final = 0.06  # outwards from a contact
_STEPS: Final = 30  # in which that is looked at
_BASELINE_M: Final = 0.1  # of the widest stereo camera for tables
BEHIND_M: Final = 0.005  # behind a place, from where on the camera sees through it
_SPARE_M, _SPARE_PIXELS = 0.008, 2.0  # of a band that are expected, too: edges have no depth
_EXPECTED: Final = np.array([_REACH_M / _STEPS, BEHIND_M, _BASELINE_M, _SPARE_M, _SPARE_PIXELS])
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
        ray, place = np.add.reduce(rays, axis=1) / len(xyz), np.add.reduce(at, axis=1) / len(xyz)
        centred = rays - ray[:, None]
        spread = np.add.reduce(centred * centred, axis=1)
        if not (spread > 0.0).all():
            return None
        focal = np.add.reduce(centred * at, axis=1) / spread
        return cls(target.image, np.stack([focal, place - focal * ray], axis=1))

    def beyond_m(self, contacts: Float64, outwards: Float64) -> Float64:
        """Measure how far pixels without depth reach outwards from contacts, beyond what is expected beside any object.

        Args:
            contacts: (N, 3) float64 [m], camera frame.
            outwards: (N, 3) float64 of unit length, from which the finger comes.

        Returns:
            (N,) float64 [m], 0 where the camera sees through the way of the finger, or what is in front of it, or nothing.
        """
        beyond = np.empty(len(contacts))
        _unseen_beyond(contacts, outwards, len(contacts), self.c_image, _STEPS, _EXPECTED, beyond)
        return beyond

    @cached_property
    def c_image(self) -> Any:
        """The image as kernels read it."""
        return self.image.c_depths(self.camera.reshape(-1))

    @cached_property
    def _focal(self) -> float:
        """Mean focal length [px]."""
        return float(np.abs(self.camera[:, 0]).mean())

    def pixel_m(self, depth_m: float) -> float:
        """Return the width of a pixel at a depth [m]."""
        return depth_m / self._focal

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
