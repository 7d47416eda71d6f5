# SPDX-License-Identifier: Apache-2.0
"""The skin of a BioTac SP: its core is an ellipsoid of revolution about x of the fingertip's frame, under a layer of even thickness."""

from typing import Final

import numpy as np

from foretouch.types import Float64

# The core's semi-axes fit the electrode positions in common use (1 to 20 within 0.03 mm; 21 to 24 sit on a flat up to 0.4 mm inside).
CORE_HALF_LENGTH_M: Final = 0.01237  # along the finger
CORE_RADIUS_M: Final = 0.008  # across the finger
LAYER_M: Final = 0.0014  # thickness of skin and liquid over the core


def skin_axes(layer_m: float = LAYER_M) -> Float64:
    """(3,) float64: semi-axes of the skin over a layer of this thickness [m]."""
    across = CORE_RADIUS_M + layer_m
    return np.array([CORE_HALF_LENGTH_M + layer_m, across, across])
