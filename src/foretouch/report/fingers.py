# SPDX-License-Identifier: Apache-2.0
"""What figures and views show of each finger."""

from typing import Final

from foretouch.types import Float64, Touch

FINGER_NAMES: Final = {"TH": "thumb", "MF": "middle finger"}
"""In the order of g1, g2."""


def finger_parts(touch: Touch, name: str) -> tuple[float, Float64]:
    """Pressure, and (24,) float64 electrodes, of `TH` or `MF` [counts]."""
    return (touch.pdc_th, touch.e_th) if name == "TH" else (touch.pdc_mf, touch.e_mf)


def electrode_levels(touch: Touch, rest: Touch | None, name: str) -> Float64:
    """(24,) float64: what the electrodes of a finger are coloured by, their drop from rest or their counts."""
    electrodes = finger_parts(touch, name)[1]
    return electrodes if rest is None else finger_parts(rest, name)[1] - electrodes
