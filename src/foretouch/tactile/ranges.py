# SPDX-License-Identifier: Apache-2.0
"""Ranges of the four modalities: data, not constants, because every hand differs.

The amount of liquid in a finger moves its counts, so a range belongs to one pair of fingers. Two
sets are named: P2's ranges (the default) and the divisors of P1's public code, which scale from 0.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from foretouch.config import Settings, load_yaml, setting
from foretouch.errors import ConfigError
from foretouch.tactile.modalities import MODALITIES, modality_size
from foretouch.types import Float64

__all__ = ["P1_RANGES", "P2_RANGES", "TactileRanges", "load_ranges"]


@dataclass(frozen=True, kw_only=True)
class TactileRanges(Settings):
    """Lowest and highest count of each modality, for scaling to [0, 1].

    Raises:
        ConfigError: If a range is not (low, high) with low < high.
    """

    pdc_th: tuple[float, ...] = setting((2500.0, 3400.0), "Static pressure of the thumb, low and high", unit="counts")
    pdc_mf: tuple[float, ...] = setting((1600.0, 2300.0), "Static pressure of the middle finger", unit="counts")
    e_th: tuple[float, ...] = setting((100.0, 3600.0), "Electrodes of the thumb", unit="counts")
    e_mf: tuple[float, ...] = setting((500.0, 3800.0), "Electrodes of the middle finger", unit="counts")

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in MODALITIES:
            limits = getattr(self, name.lower())
            if len(limits) != 2 or limits[0] >= limits[1]:
                raise ConfigError(f"TactileRanges.{name.lower()}: {list(limits)} is not [low, high] with low < high")

    def of(self, modality: str) -> tuple[float, float]:
        """(low, high) of one modality [counts].

        Raises:
            TactileError: If there is no such modality.
        """
        modality_size(modality)
        low, high = getattr(self, modality.lower())
        return low, high

    @property
    def low(self) -> Float64:
        """(50,) float64, lower ends in the order of `Touch.vector()` [counts]."""
        return self._vector(0)

    @property
    def high(self) -> Float64:
        """(50,) float64, upper ends in the order of `Touch.vector()` [counts]."""
        return self._vector(1)

    def scale(self, counts: npt.ArrayLike) -> Float64:
        """Counts (..., 50) to [0, 1]; what lies outside its range leaves [0, 1] and is not clipped."""
        return (np.asarray(counts, np.float64) - self.low) / (self.high - self.low)

    def unscale(self, scaled: npt.ArrayLike) -> Float64:
        """The inverse of `scale`: (..., 50) to counts."""
        return np.asarray(scaled, np.float64) * (self.high - self.low) + self.low

    def outside(self, counts: npt.ArrayLike) -> npt.NDArray[np.bool_]:
        """Which of (..., 50) counts leave their range; NaN counts as outside."""
        values = np.asarray(counts, np.float64)
        return np.asarray(~((values >= self.low) & (values <= self.high)), np.bool_)

    def _vector(self, end: int) -> Float64:
        return np.concatenate([np.full(modality_size(name), self.of(name)[end]) for name in MODALITIES])


P2_RANGES: Final = TactileRanges()
"""Found empirically for the sensors of P2 (section III-C)."""

P1_RANGES: Final = TactileRanges(pdc_th=(0.0, 3100.0), pdc_mf=(0.0, 2000.0), e_th=(0.0, 3500.0), e_mf=(0.0, 3800.0))
"""P1's public code divides the labels by these numbers."""

_NAMED: Final = {"p1": P1_RANGES, "p2": P2_RANGES}


def load_ranges(name_or_path: str | Path) -> TactileRanges:
    """Ranges by name (`p1`, `p2`) or from a YAML file; what the file leaves out keeps P2's value.

    Raises:
        ConfigError: If the file cannot be read or breaks a rule of `TactileRanges`.
    """
    named = _NAMED.get(str(name_or_path))
    return named or TactileRanges.from_mapping(load_yaml(name_or_path), str(name_or_path))
