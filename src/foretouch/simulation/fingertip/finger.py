# SPDX-License-Identifier: Apache-2.0
"""What distinguishes one fingertip from another: rest and gain, which inflation, wear and make decide."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from foretouch.config import Settings, setting
from foretouch.types import ELECTRODES, Float64

__all__ = ["MIDDLE_FINGER", "THUMB", "Finger", "FingerConfig", "draw_finger"]

_LOWEST_REST: Final = 500.0
_HIGHEST_REST: Final = 4000.0


@dataclass(frozen=True, kw_only=True)
class FingerConfig(Settings):
    """Rest and gain of a kind of fingertip; a spread of 0 makes all its electrodes equal."""

    pdc_rest: float = setting(1676.0, "PDC without contact", unit="counts", minimum=1.0, maximum=4094.0)
    pdc_gain: float = setting(1.0, "Factor on the rise of PDC", minimum=0.0)
    electrode_rest: float = setting(3450.0, "Electrodes without contact", unit="counts", minimum=500.0, maximum=4000.0)
    electrode_rest_spread: float = setting(
        70.0, "Standard deviation of that from electrode to electrode", unit="counts", minimum=0.0
    )
    electrode_gain: float = setting(1.0, "Factor on the approach of the skin", minimum=0.0)
    electrode_gain_spread: float = setting(
        0.1, "Standard deviation of its logarithm from electrode to electrode", minimum=0.0
    )


MIDDLE_FINGER: Final = FingerConfig()
"""PDC as real ones at rest; electrodes so that in grasps their 95th percentile is near that of real ones, 3600."""

THUMB: Final = FingerConfig(pdc_rest=2779.0, electrode_rest=3150.0)
"""The same for a thumb, whose electrodes reach 3350: PDC is higher, electrodes are lower."""


@dataclass(frozen=True, eq=False)
class Finger:
    """One fingertip.

    Attributes:
        pdc_rest: PDC without contact [counts].
        pdc_gain: Factor on its rise.
        electrode_rest: (24,) float64 [counts].
        electrode_gain: (24,) float64.
    """

    pdc_rest: float
    pdc_gain: float
    electrode_rest: Float64
    electrode_gain: Float64


def draw_finger(config: FingerConfig, rng: np.random.Generator) -> Finger:
    """One fingertip of a kind; the same random numbers are drawn whatever the spreads."""
    rest = config.electrode_rest + config.electrode_rest_spread * rng.standard_normal(ELECTRODES)
    gain = config.electrode_gain * np.exp(config.electrode_gain_spread * rng.standard_normal(ELECTRODES))
    return Finger(config.pdc_rest, config.pdc_gain, np.clip(rest, _LOWEST_REST, _HIGHEST_REST), gain)
