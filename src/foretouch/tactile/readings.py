# SPDX-License-Identifier: Apache-2.0
"""Check tactile readings, subtract a tare, and convert counts of electrodes to impedances.

Hands report a finger without a sensor as 24 zeros, and a dead one as a PDC that never moves, at values such as -22072
that a 12-bit converter cannot produce. Those are faults.

The BioTac SP is not temperature-compensated and drifts with temperature, inflation and wear, so counts are comparable
only with readings of the same finger at rest shortly before: the tare.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from foretouch.errors import TactileError
from foretouch.types import Bool, Float64, Touch
from foretouch.types.channels import Channel, Channels

FULL_SCALE: Final = 4095  # largest count of the 12-bit converter of the BioTac SP

_REFERENCE_KOHM: Final = 10.0


def touch_faults(touch: Touch, finger: str = "") -> tuple[str, ...]:
    """Return why working sensors cannot have produced a reading, or the part of one finger; one line each, empty if they can.

    Single taxels may be dead: NaN or out of range. A finger of which half of them or more are does not work.
    """
    channels = touch.channels
    if ((touch.values >= channels.low) & (touch.values <= channels.high)).all():
        return ()
    first, step = (channels.fingers.index(finger), len(channels.fingers)) if finger else (0, 1)
    names = channels.modalities[first::step]
    return tuple(filter(None, (_fault(name.lower(), channels.channel_of[name], touch[name]) for name in names)))


def _fault(name: str, channel: Channel, values: Float64) -> str:
    wrong = np.flatnonzero(~((values >= channel.low) & (values <= channel.high)))  # NaN is a fault too
    if 2 * wrong.size < max(2, values.size):
        return ""
    if np.isnan(values).all():
        return f"{name}: was not read"
    rule = f"is not between {channel.low:g} and {channel.high:g} {channel.unit}"
    if channel.size == 1:
        return f"{name}: {values[0]:g} {rule}, an absent or dead sensor"
    if not values.any():
        return f"{name}: all {values.size} values are 0, an absent sensor"
    return f"{name}[{wrong[0]}]: {values[wrong[0]]:g} {rule} ({wrong.size} such values)"


def make_tare(readings: Sequence[Touch]) -> Touch:
    """Return the median of readings without contact; a `TactileError` without readings, or if one is not valid."""
    if not readings:
        raise TactileError("tare: no reading")
    for i, reading in enumerate(readings):
        if faults := touch_faults(reading):
            raise TactileError(f"tare: reading {i}: {faults[0]}")
    return rest_of(np.median([reading.values for reading in readings], axis=0), readings[0].channels)


def rest_of(values: npt.ArrayLike, channels: Channels) -> Touch:
    """Return the tare of (D,) values at rest, which is 0 for a channel whose rest level is zero, whatever was read."""
    return Touch(np.where(channels.tared, np.asarray(values, np.float64), 0.0), channels)


def tdc_of(values: Mapping[str, float], channels: Channels, prefix: str = "") -> Float64:
    """Return (F,) TDC of the fingers of a touch [counts] among further channels by name; NaN where it is absent or dead.

    Args:
        values: As `Sample.extra`.
        channels: Of the touch, for the names of its fingers.
        prefix: Before the names: `tare_` for the temperatures of the tare.
    """
    tdc = np.array([values.get(f"{prefix}TDC_{finger}", np.nan) for finger in channels.fingers], np.float64)
    return np.where(is_tdc(tdc), tdc, np.nan)


def is_tdc(values: Float64) -> Bool:
    """Return which values a working thermistor can have sent: not NaN, not 0 as of drivers without one, and not saturated."""
    return (values > 0.0) & (values < FULL_SCALE)


def to_celsius(tdc: float) -> float:
    """Return the temperature of a finger [°C] by its TDC [counts], for which `is_tdc` holds, by the product manual."""
    share = tdc / FULL_SCALE
    return 4025.0 / math.log((155183.0 - 46555.0 * share) / share) - 273.15


def to_kohm(electrode: npt.ArrayLike) -> Float64:
    """Return the impedance of electrodes [kOhm], float64, by the product manual: Z = (4095 / E - 1) * 10.

    Raises:
        TactileError: If a count is not finite, above 4095, or not above 0, where Z is undefined.
    """
    counts = np.asarray(electrode, np.float64)
    wrong = ~((counts <= FULL_SCALE) & (counts > 0.0))
    if wrong.any():
        raise TactileError(f"electrode: {counts[wrong].flat[0]:g} is not above 0 and at most {FULL_SCALE} counts")
    return np.asarray((FULL_SCALE / counts - 1.0) * _REFERENCE_KOHM, np.float64)
