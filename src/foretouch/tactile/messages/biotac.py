# SPDX-License-Identifier: Apache-2.0
"""The messages of a BioTac SP, of which a finger sends PDC and 24 electrodes.

BiotacAll       of the Shadow Hand's driver, in `foretouch_msgs` and, with the same fields, in `sr_robot_msgs`
TactileState    one channel of numbers for each finger, PDC and the electrodes, named as the driver chooses
String          a CSV line of `biotac_sp_ros`: a time, printed with six digits and therefore not usable, and 54 numbers for each of
                three sensors: E1, PAC, E2, PAC, ... E24, PAC, PDC, PAC, TAC, PAC, TDC, PAC; fingers are named by the index of theirs
"""

from collections.abc import Sequence
from functools import partial
from typing import Any, Final

import numpy as np

from foretouch.errors import ConfigError, TactileError
from foretouch.tactile import ELECTRODES
from foretouch.tactile.messages.table import ARRIVAL_STAMPED, TactileConfig, TactileReader, TactileReading
from foretouch.types import Float32, stamp_ns

FINGERS: Final = ("TH", "MF")
FINGER_ORDER: Final = ("FF", "MF", "RF", "LF", "TH")  # order of the fingers in `BiotacAll.tactiles`
OTHERS: Final = ("PAC0", "PAC1", "TAC", "TDC")  # what a finger sends besides in `BiotacAll`

_SENSORS: Final = ("0", "1", "2")  # of a CSV line
_PER_SENSOR: Final = 54
_FIELDS: Final = 1 + len(_SENSORS) * _PER_SENSOR


def make_reader(config: TactileConfig) -> TactileReader:
    """Return the decoder for the chosen fingers; a `ConfigError` for a name that the type does not have."""
    read, known, others = {
        "std_msgs/String": (_csv, _SENSORS, ("TAC", "TDC")),
        "tactile_msgs/TactileState": (_tactile_state, config.fingers, ()),
    }.get(config.type, (_biotac_all, FINGER_ORDER, OTHERS))
    for name, which in zip(config.fingers, ("thumb", "middle"), strict=True):
        if name not in known:
            raise ConfigError(f"{which}: {name!r} is not one of {', '.join(known)}")
    flags = (ARRIVAL_STAMPED,) if read is _csv else ()
    names = tuple(f"{name}_{finger}" for finger in FINGERS for name in others)
    return TactileReader(partial(_read, config.fingers, read), names, flags)


def _read(fingers: Sequence[str], read: Any, message: Any) -> TactileReading:
    """Return a reading from (25 + K,) numbers of each finger: PDC, electrodes and others."""
    th, mf = read(message, fingers)
    end = 1 + ELECTRODES
    counts = np.concatenate([th[:1], mf[:1], th[1:end], mf[1:end]])
    if not np.isfinite(counts).all():
        raise TactileError(f"{'CSV' if read is _csv else 'TactileState'}: a count is not finite")
    stamp = None if read is _csv else stamp_ns(message.header.stamp)
    return TactileReading(stamp, counts, np.concatenate([th[end:], mf[end:]]))


def finger_counts(message: Any, finger: str) -> Float32:
    """Return (1 + n,) float32 counts of one finger in `BiotacAll`: PDC, then the electrodes."""
    tactile = message.tactiles[FINGER_ORDER.index(finger)]
    return np.array([tactile.pdc, *tactile.electrodes], np.float32)


def _biotac_all(message: Any, fingers: Sequence[str]) -> list[Float32]:
    rows = []
    for finger in fingers:
        counts, tactile = finger_counts(message, finger), message.tactiles[FINGER_ORDER.index(finger)]
        if len(counts) != 1 + ELECTRODES:
            raise TactileError(f"{finger}: {len(counts) - 1} electrodes, a BioTac SP has {ELECTRODES}")
        rows.append(np.append(counts, [np.float32(getattr(tactile, name.lower())) for name in OTHERS]))
    return rows


def _tactile_state(message: Any, fingers: Sequence[str]) -> list[Float32]:
    channels = {sensor.name: np.asarray(sensor.values, np.float32) for sensor in message.sensors}
    for name in fingers:
        if name not in channels:
            raise TactileError(f"{name}: no such channel; there are {', '.join(map(repr, channels)) or 'none'}")
        if len(channels[name]) <= ELECTRODES:
            raise TactileError(f"{name}: {len(channels[name])} values, {1 + ELECTRODES} are needed")
    return [channels[name][: 1 + ELECTRODES] for name in fingers]


def _csv(message: Any, fingers: Sequence[str]) -> list[Float32]:
    fields = message.data.split(",")
    if len(fields) != _FIELDS:
        raise TactileError(f"CSV: {len(fields)} fields, a line of biotac_sp_ros has {_FIELDS}")
    try:
        values = np.array(fields[1:], np.float32).reshape(len(_SENSORS), _PER_SENSOR)[:, ::2]  # every second is PAC
    except ValueError as err:
        raise TactileError(f"CSV: {err}") from err
    rows = [values[int(finger)] for finger in fingers]
    return [np.r_[row[ELECTRODES], row[:ELECTRODES], row[ELECTRODES + 1 :]] for row in rows]
