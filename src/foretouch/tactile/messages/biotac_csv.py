# SPDX-License-Identifier: Apache-2.0
"""`std_msgs/String` with a CSV line of `biotac_sp_ros`; it has no stamp.

A line holds a time, printed with six digits and therefore not usable, and 54 numbers for each of three sensors:
E1, PAC, E2, PAC, ... E24, PAC, PDC, PAC, TAC, PAC, TDC, PAC. Fingers are named by the index of their sensor.
"""

from functools import partial
from typing import Any, Final

import numpy as np

from foretouch.errors import TactileError
from foretouch.tactile import ELECTRODES
from foretouch.tactile.messages.table import ARRIVAL_STAMPED, TactileConfig, TactileReader, TactileReading, named_index

FINGERS: Final = ("0", "1")

_SENSORS: Final = ("0", "1", "2")
_PER_SENSOR: Final = 54
_FIELDS: Final = 1 + len(_SENSORS) * _PER_SENSOR


def make_reader(config: TactileConfig) -> TactileReader:
    """The decoder for the chosen sensors (raises `ConfigError` for names other than 0, 1, 2)."""
    names = zip(config.fingers, ("thumb", "middle"), strict=True)
    thumb, middle = (named_index(name, _SENSORS, which) for name, which in names)
    others = ("TAC_TH", "TDC_TH", "TAC_MF", "TDC_MF")
    return TactileReader(partial(_read, thumb=thumb, middle=middle), others, (ARRIVAL_STAMPED,))


def _read(message: Any, thumb: int, middle: int) -> TactileReading:
    fields = message.data.split(",")
    if len(fields) != _FIELDS:
        raise TactileError(f"CSV: {len(fields)} fields, a line of biotac_sp_ros has {_FIELDS}")
    try:
        values = np.array(fields[1:], np.float32).reshape(len(_SENSORS), _PER_SENSOR)[:, ::2]  # every second is PAC
    except ValueError as err:
        raise TactileError(f"CSV: {err}") from err
    th, mf = values[thumb], values[middle]
    electrodes, pdc = slice(0, ELECTRODES), slice(ELECTRODES, ELECTRODES + 1)
    counts = np.concatenate([th[pdc], mf[pdc], th[electrodes], mf[electrodes]])
    if not np.isfinite(counts).all():
        raise TactileError("CSV: a count is not finite")
    return TactileReading(None, counts, np.concatenate([th[ELECTRODES + 1 :], mf[ELECTRODES + 1 :]]))
