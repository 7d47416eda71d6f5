# SPDX-License-Identifier: Apache-2.0
"""Check tactile readings, subtract a tare, and convert counts to physical units.

Hands report a finger without a sensor as 24 zeros, and a dead one as a PDC that never moves, at values such as -22072
that a 12-bit converter cannot produce. Those are faults. A reading of a working sensor outside the range of its
modality is only flagged.

The BioTac SP is not temperature-compensated and drifts with temperature, inflation and wear, so counts are comparable
only with those of the same finger at rest shortly before: the tare.

Units follow the formulas of the product manual. Every conversion takes numbers or arrays of any shape and returns
float64 of that shape; it rejects counts that a 12-bit converter cannot produce or where the formula is undefined.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from foretouch.errors import TactileError
from foretouch.tactile.channels import MODALITIES, P2_RANGES, TactileRanges, columns
from foretouch.types import Float64, Touch

FULL_SCALE: Final = 4095
"""Largest count of the 12-bit converter."""

CONSTANT_SAMPLES: Final = 3000
"""A PDC equal over so many samples (30 s at 100 Hz) is dead: at rest it still moves by 0.06 counts or more (std)."""

_KPA_PER_COUNT: Final = 0.0365
_PA_PER_COUNT: Final = 0.37
_REFERENCE_KOHM: Final = 10.0
_ZERO_CELSIUS_K: Final = 273.15


@dataclass(frozen=True, kw_only=True)
class TouchValidity:
    """Whether a reading is valid, and what is wrong with it."""

    faults: tuple[str, ...] = ()  # why a working sensor cannot have produced it, one line each; empty if it is valid
    out_of_range: tuple[str, ...] = ()  # the modalities with a value outside their range

    @property
    def valid(self) -> bool:
        """Whether a working sensor can have produced it."""
        return not self.faults

    def require(self) -> None:
        """Raise a `TactileError` that names all faults in one line, if there are any."""
        if self.faults:
            raise TactileError("; ".join(self.faults))


def check_touch(touch: Touch, ranges: TactileRanges = P2_RANGES) -> TouchValidity:
    """Check one reading of both fingers.

    Args:
        touch: The reading [counts].
        ranges: Value ranges of the hand that produced it.
    """
    faults = [
        *_pdc_faults("pdc_th", touch.pdc_th),
        *_pdc_faults("pdc_mf", touch.pdc_mf),
        *_electrode_faults("e_th", touch.e_th),
        *_electrode_faults("e_mf", touch.e_mf),
    ]
    outside = ranges.outside(touch.vector())
    out_of_range = tuple(name for name in MODALITIES if outside[columns([name])].any())
    return TouchValidity(faults=tuple(faults), out_of_range=out_of_range)


def check_series(pdc: npt.ArrayLike, *, name: str = "pdc", samples: int = CONSTANT_SAMPLES) -> TouchValidity:
    """Check the static pressure of one finger over time: that of a dead sensor never changes.

    Args:
        pdc: (T,) [counts].
        name: The finger's name, for the message.
        samples: Number of equal samples from which the sensor counts as dead. Shorter series are valid.
    """
    values = np.asarray(pdc, np.float64)
    if values.size >= samples and np.all(values == values[0]):
        return TouchValidity(faults=(f"{name}: constant at {values[0]:g} over {values.size} samples, a dead sensor",))
    return TouchValidity()


def _pdc_faults(name: str, value: float) -> list[str]:
    if not 0 < value <= FULL_SCALE:  # NaN fails too
        return [f"{name}: {value:g} is not between 0 and {FULL_SCALE} counts, an absent or dead sensor"]
    return []


def _electrode_faults(name: str, values: Float64) -> list[str]:
    if not values.any():
        return [f"{name}: all {values.size} electrodes are 0, an absent sensor"]
    wrong = np.flatnonzero(~((values > 0) & (values <= FULL_SCALE)))
    if wrong.size:
        k = int(wrong[0])
        return [f"{name}[{k}]: {values[k]:g} is not between 0 and {FULL_SCALE} counts ({wrong.size} such electrodes)"]
    return []


def make_tare(readings: Sequence[Touch]) -> Touch:
    """The median of readings without contact; a single disturbed sample does not move it.

    Raises:
        TactileError: If there is no reading, or one is not valid.
    """
    if not readings:
        raise TactileError("tare: no reading")
    for i, reading in enumerate(readings):
        if faults := check_touch(reading).faults:
            raise TactileError(f"tare: reading {i}: {faults[0]}")
    return Touch.from_vector(np.median([reading.vector() for reading in readings], axis=0))


def offsets(touch: Touch, tare: Touch) -> Float64:
    """(50,) float64 [counts], touch minus tare: with pressure, PDC rises and electrodes fall."""
    return touch.vector() - tare.vector()


def restore(offset: Float64, tare: Touch) -> Touch:
    """The inverse of `offsets`."""
    return Touch.from_vector(offset + tare.vector())


def to_kpa(pdc: npt.ArrayLike, offset: npt.ArrayLike) -> Float64:
    """Static pressure above that without contact [kPa]: (PDC - offset) * 0.0365.

    Args:
        pdc: Static pressure [counts], 0 to 4095.
        offset: PDC without contact [counts]: a tare, since rest differs from finger to finger and drifts.

    Raises:
        TactileError: If a count is not finite or outside 0 to 4095.
    """
    return (_counts("pdc", pdc) - _counts("offset", offset)) * _KPA_PER_COUNT


def to_pa(pac: npt.ArrayLike, offset: npt.ArrayLike) -> Float64:
    """Vibration about its rest value [Pa]: (PAC - offset) * 0.37; errors as in `to_kpa`."""
    return (_counts("pac", pac) - _counts("offset", offset)) * _PA_PER_COUNT


def to_kohm(electrode: npt.ArrayLike) -> Float64:
    """Impedance of an electrode [kOhm]: Z = (4095 / E - 1) * 10. Compression lowers E and raises Z.

    Raises:
        TactileError: If a count is not finite, above 4095, or not above 0, where Z is undefined.
    """
    return (FULL_SCALE / _counts("electrode", electrode, above_zero=True) - 1.0) * _REFERENCE_KOHM


def to_celsius(tdc: npt.ArrayLike) -> Float64:
    """Temperature [degrees C]: 4025 / ln((155183 - 46555 x) / x) - 273.15 with x = TDC / 4095.

    Errors as in `to_kohm`.
    """
    x = _counts("tdc", tdc, above_zero=True) / FULL_SCALE
    return 4025.0 / np.log((155183.0 - 46555.0 * x) / x) - _ZERO_CELSIUS_K


def _counts(name: str, values: npt.ArrayLike, *, above_zero: bool = False) -> Float64:
    counts = np.asarray(values, np.float64)
    wrong = ~((counts <= FULL_SCALE) & ((counts > 0.0) if above_zero else (counts >= 0.0)))
    if wrong.any():
        first = counts[wrong].flat[0] if counts.ndim else float(counts)
        bound = "above" if above_zero else "at least"
        raise TactileError(f"{name}: {first:g} is not {bound} 0 and at most {FULL_SCALE} counts")
    return counts
