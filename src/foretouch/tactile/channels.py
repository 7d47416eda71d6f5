# SPDX-License-Identifier: Apache-2.0
"""The 50 values of a reading: modalities and their columns, value ranges, and the electrodes of `config/sensors/biotac_sp.yaml`.

P2 predicts four modalities: PDC_TH, PDC_MF (one value each), E_TH and E_MF (24 electrodes each). Their ranges are
settings, not constants: the amount of liquid in a finger shifts its counts, so a range belongs to one pair of fingers.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
import numpy.typing as npt

from foretouch.config import Settings, setting
from foretouch.errors import ConfigError, TactileError
from foretouch.tactile.description import packaged_sensor
from foretouch.types import ELECTRODES, Bool, Float64, Index

FINGER_NAMES: Final = {"TH": "thumb", "MF": "middle finger"}
"""Names of the fingers that touch g1 and g2, for people."""

MODALITIES: Final = ("PDC_TH", "PDC_MF", "E_TH", "E_MF")
_SIZES: Final = (1, 1, ELECTRODES, ELECTRODES)
_COLUMNS: Final = dict(zip(MODALITIES, np.split(np.arange(sum(_SIZES)), np.cumsum(_SIZES)[:-1]), strict=True))
_NARROWEST: Final = 1e-6  # [counts]
_WIDEST: Final = 1e12  # [counts]


def columns(modalities: Sequence[str]) -> Index:
    """(M,) columns of some modalities in `Touch.vector()`, in this order; a `TactileError` names an unknown one."""
    unknown = [name for name in modalities if name not in _COLUMNS]
    if unknown:
        raise TactileError(f"modality: {unknown[0]!r} is none of {', '.join(MODALITIES)}")
    return np.concatenate([np.empty(0, np.intp), *(_COLUMNS[name] for name in modalities)])


def modality_size(modality: str) -> int:
    """Number of values of one modality, 1 or 24; a `TactileError` if there is no such modality."""
    return len(columns([modality]))


@dataclass(frozen=True, kw_only=True)
class TactileRanges(Settings):
    """Lowest and highest count of each modality, for scaling to [0, 1].

    Raises:
        ConfigError: If a range is not (low, high) with low < high, or is too narrow or too wide to divide by.
    """

    pdc_th: tuple[float, ...] = setting((2500.0, 3400.0), "Static pressure of the thumb, low and high", unit="counts")
    pdc_mf: tuple[float, ...] = setting((1600.0, 2300.0), "Static pressure of the middle finger", unit="counts")
    e_th: tuple[float, ...] = setting((100.0, 3600.0), "Electrodes of the thumb", unit="counts")
    e_mf: tuple[float, ...] = setting((500.0, 3800.0), "Electrodes of the middle finger", unit="counts")

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in MODALITIES:
            limits = getattr(self, name.lower())
            shown = f"{name.lower()}: {list(limits)}"
            if len(limits) != 2 or limits[0] >= limits[1]:
                raise ConfigError(f"{shown} is not [low, high] with low < high")
            if not _NARROWEST <= limits[1] - limits[0] <= _WIDEST:
                raise ConfigError(f"{shown}: high - low is not between {_NARROWEST:g} and {_WIDEST:g} counts")

    def of(self, modality: str) -> tuple[float, float]:
        """(low, high) of one modality [counts]; a `TactileError` if there is no such modality."""
        modality_size(modality)
        low, high = getattr(self, modality.lower())
        return low, high

    @cached_property
    def low(self) -> Float64:
        """(50,) float64, lower bounds in the order of `Touch.vector()` [counts]; read-only."""
        return self._vector(0)

    @cached_property
    def high(self) -> Float64:
        """(50,) float64, upper bounds in the order of `Touch.vector()` [counts]; read-only."""
        return self._vector(1)

    def scale(self, counts: npt.ArrayLike) -> Float64:
        """Scale counts (..., 50) to [0, 1]; values outside their range leave [0, 1] and are not clipped."""
        return (np.asarray(counts, np.float64) - self.low) / (self.high - self.low)

    def outside(self, counts: npt.ArrayLike) -> Bool:
        """Which of (..., 50) counts are outside their range; NaN is outside."""
        values = np.asarray(counts, np.float64)
        return np.asarray(~((values >= self.low) & (values <= self.high)), np.bool_)

    def _vector(self, end: int) -> Float64:
        found = np.concatenate([np.full(modality_size(name), self.of(name)[end]) for name in MODALITIES])
        found.flags.writeable = False  # it is kept
        return found


P2_RANGES: Final = TactileRanges()  # found empirically for the sensors of P2 (section III-C)

#: P1's public code divides the labels by these numbers.
P1_RANGES: Final = TactileRanges(pdc_th=(0.0, 3100.0), pdc_mf=(0.0, 2000.0), e_th=(0.0, 3500.0), e_mf=(0.0, 3800.0))


def electrode_positions() -> Float64:
    """(24, 3) float64 [m], fingertip frame; row k is electrode k + 1; read-only."""
    return packaged_sensor("biotac_sp").layout.positions


def electrode_normals() -> Float64:
    """(24, 3) float64, outward unit normals, radial from the axis of the core (x); read-only."""
    return packaged_sensor("biotac_sp").layout.normals
