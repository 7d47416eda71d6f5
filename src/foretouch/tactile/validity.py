# SPDX-License-Identifier: Apache-2.0
"""Whether a reading can come from a working BioTac SP.

Hands report a finger without a sensor as 24 zeros, and a dead one as a PDC that never moves, at values
such as -22072 that a 12-bit converter cannot give. Those are faults. A reading of a working sensor that
leaves the ranges of its modality is only flagged.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from foretouch.errors import TactileError
from foretouch.tactile.modalities import MODALITIES, columns
from foretouch.tactile.ranges import P2_RANGES, TactileRanges
from foretouch.tactile.units import FULL_SCALE
from foretouch.types import Float64, Touch

__all__ = ["CONSTANT_SAMPLES", "TouchCheck", "check_series", "check_touch"]

CONSTANT_SAMPLES = 3000
"""A PDC equal over so many samples (30 s at 100 Hz) is dead: at rest it still moves by 0.06 counts or more (std)."""


@dataclass(frozen=True, kw_only=True)
class TouchCheck:
    """What is wrong with one reading.

    Attributes:
        faults: Why it is no reading of a working sensor, one line each; empty if it can be one.
        out_of_range: The modalities with a value outside their range.
    """

    faults: tuple[str, ...] = ()
    out_of_range: tuple[str, ...] = ()

    @property
    def valid(self) -> bool:
        """Whether a working sensor can have given it."""
        return not self.faults

    def require(self) -> None:
        """Raise when it is not valid.

        Raises:
            TactileError: Names all faults in one line.
        """
        if self.faults:
            raise TactileError("; ".join(self.faults))


def check_touch(touch: Touch, ranges: TactileRanges = P2_RANGES) -> TouchCheck:
    """Judge one reading of both fingers.

    Args:
        touch: The reading [counts].
        ranges: Of the hand that it was read from.
    """
    faults = [
        *_pdc_faults("pdc_th", touch.pdc_th),
        *_pdc_faults("pdc_mf", touch.pdc_mf),
        *_electrode_faults("e_th", touch.e_th),
        *_electrode_faults("e_mf", touch.e_mf),
    ]
    outside = ranges.outside(touch.vector())
    return TouchCheck(
        faults=tuple(faults),
        out_of_range=tuple(name for name in MODALITIES if outside[columns([name])].any()),
    )


def check_series(pdc: npt.ArrayLike, *, name: str = "pdc", samples: int = CONSTANT_SAMPLES) -> TouchCheck:
    """Judge the static pressure of one finger over time: a dead one never moves.

    Args:
        pdc: (T,) [counts].
        name: The finger's name, for the message.
        samples: From how many equal samples on it counts as dead. Shorter series cannot be judged and pass.
    """
    values = np.asarray(pdc, np.float64)
    if values.size >= samples and np.all(values == values[0]):
        return TouchCheck(faults=(f"{name}: constant at {values[0]:g} over {values.size} samples, a dead sensor",))
    return TouchCheck()


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
