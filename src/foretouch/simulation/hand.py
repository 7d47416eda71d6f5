# SPDX-License-Identifier: Apache-2.0
"""Where the two fingertips are when the hand closes."""

from dataclasses import dataclass

import numpy as np

from foretouch.types import Float64


@dataclass(frozen=True, eq=False)
class FingerFrame:
    """The tangent frame of a fingertip at its contact, in the world.

    Attributes:
        origin: (3,) float64 [m], where the pad is to touch.
        rotation: (3, 3) float64, columns: tangent x along the finger to its tip, tangent y across, and the pad's
            outward normal, which is the way in which the finger closes. Matches `contact.ContactFrame`.
    """

    origin: Float64
    rotation: Float64

    @property
    def approach(self) -> Float64:
        """(3,) float64, unit length: the way in which the finger closes."""
        return self.rotation[:, 2]

    def points(self, x: Float64, y: Float64, depth: float) -> Float64:
        """(..., 3) float64 [m], world, of points at (x, y) of the tangent plane, moved by `depth` along the approach."""
        return self.origin + np.stack([x, y, np.full_like(x, depth)], axis=-1) @ self.rotation.T


def finger_frames(g1: Float64, g2: Float64, hand: Float64, up: Float64) -> tuple[FingerFrame, FingerFrame]:
    """Thumb at g1 and middle finger at g2, closing towards each other, both pointing down.

    The hand's Y is along the object's axis and Z along g1 - g2, so the fingers lie along its X; which end of X
    they point to is not said by the grasp, and the hand comes from above.

    Args:
        g1: (3,) float64 [m].
        g2: (3,) float64 [m].
        hand: (3, 3) float64, the grasp's rotation in the frame of the points.
        up: (3,) float64, the table's normal in that frame.
    """
    along = hand[:, 0] if hand[:, 0] @ up < 0.0 else -hand[:, 0]
    frames = [
        FingerFrame(origin, np.column_stack([along, np.cross(approach, along), approach]))
        for origin, approach in ((g1, -hand[:, 2]), (g2, hand[:, 2]))
    ]
    return frames[0], frames[1]
