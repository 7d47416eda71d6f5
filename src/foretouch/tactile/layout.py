# SPDX-License-Identifier: Apache-2.0
"""Where the 24 electrodes sit on the rigid core of a BioTac SP.

Frame of the fingertip: x along the finger towards its tip, -z towards the pad, y completes it.
Positions are those in common use, rounded to 0.01 mm; electrodes 11 to 20 mirror 1 to 10 with +y.

Unverified: that this numbering is the order of the 24 columns of a recording, and that the core is
a cylinder about x, on which the radial normals rest; at its rounded tip they are an approximation.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from foretouch.types import Float64

__all__ = ["electrode_normals", "electrode_positions"]

_LEFT_MM: Final = (
    (9.82, -3.98, -2.77),
    (8.10, -3.07, -5.21),
    (2.22, -7.16, -3.27),
    (2.13, -5.12, -5.99),
    (-0.47, -2.41, -7.62),
    (-2.33, -7.24, -3.06),
    (-3.47, -4.75, -6.03),
    (-5.68, -1.82, -6.88),
    (-8.15, -3.25, -5.07),
    (-10.08, -3.85, -2.54),
)
_MIDDLE_MM: Final = ((6.57, 0.0, -6.41), (4.32, -1.85, -6.97), (4.32, 1.85, -6.97), (1.91, 0.0, -7.57))


def electrode_positions() -> Float64:
    """(24, 3) float64 [m], fingertip frame; row k is electrode k + 1."""
    left = np.array(_LEFT_MM)
    return np.concatenate([left, left * (1.0, -1.0, 1.0), np.array(_MIDDLE_MM)]) / 1000.0


def electrode_normals() -> Float64:
    """(24, 3) float64, outward unit normals, radial from the axis of the core (x)."""
    radial = electrode_positions() * (0.0, 1.0, 1.0)
    return np.asarray(radial / np.linalg.norm(radial, axis=1, keepdims=True), np.float64)
