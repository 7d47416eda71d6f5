# SPDX-License-Identifier: Apache-2.0
"""Counts of a BioTac SP to kPa, kOhm and degrees Celsius, by the formulas of its product manual.

Every function takes numbers or arrays of any shape and gives float64 of that shape. Counts that a
12-bit converter cannot give, or where a formula has no value, are refused by name.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from foretouch.errors import TactileError
from foretouch.types import Float64

__all__ = ["FULL_SCALE", "to_celsius", "to_kohm", "to_kpa", "to_pa"]

FULL_SCALE: Final = 4095
"""Largest count of the 12-bit converter."""

_KPA_PER_COUNT: Final = 0.0365
_PA_PER_COUNT: Final = 0.37
_REFERENCE_KOHM: Final = 10.0
_ZERO_CELSIUS_K: Final = 273.15


def to_kpa(pdc: npt.ArrayLike, offset: npt.ArrayLike) -> Float64:
    """Static pressure above that of no contact [kPa]: (PDC - offset) * 0.0365.

    Args:
        pdc: Static pressure [counts], 0 to 4095.
        offset: PDC without contact [counts]: a tare, since rest differs from finger to finger and drifts.

    Raises:
        TactileError: If a count is not finite or outside 0 to 4095.
    """
    return (_counts("pdc", pdc, lowest=0.0) - _counts("offset", offset, lowest=0.0)) * _KPA_PER_COUNT


def to_pa(pac: npt.ArrayLike, offset: npt.ArrayLike) -> Float64:
    """Vibration about its rest [Pa]: (PAC - offset) * 0.37.

    Raises:
        TactileError: If a count is not finite or outside 0 to 4095.
    """
    return (_counts("pac", pac, lowest=0.0) - _counts("offset", offset, lowest=0.0)) * _PA_PER_COUNT


def to_kohm(electrode: npt.ArrayLike) -> Float64:
    """Impedance of an electrode [kOhm]: Z = (4095 / E - 1) * 10. Compression lowers E and raises Z.

    Raises:
        TactileError: If a count is not finite, above 4095, or not above 0, where Z has no value.
    """
    return (FULL_SCALE / _counts("electrode", electrode, lowest=0.0, open_end=True) - 1.0) * _REFERENCE_KOHM


def to_celsius(tdc: npt.ArrayLike) -> Float64:
    """Temperature [degrees C]: 4025 / ln((155183 - 46555 x) / x) - 273.15 with x = TDC / 4095.

    Raises:
        TactileError: If a count is not finite, above 4095, or not above 0, where the formula has no value.
    """
    x = _counts("tdc", tdc, lowest=0.0, open_end=True) / FULL_SCALE
    return 4025.0 / np.log((155183.0 - 46555.0 * x) / x) - _ZERO_CELSIUS_K


def _counts(name: str, values: npt.ArrayLike, *, lowest: float, open_end: bool = False) -> Float64:
    counts = np.asarray(values, np.float64)
    low_enough = counts <= FULL_SCALE
    high_enough = counts > lowest if open_end else counts >= lowest
    wrong = ~(low_enough & high_enough)
    if wrong.any():
        first = counts[wrong].flat[0] if counts.ndim else float(counts)
        bound = "above" if open_end else "at least"
        raise TactileError(f"{name}: {first:g} is not {bound} {lowest:g} and at most {FULL_SCALE} counts")
    return counts
