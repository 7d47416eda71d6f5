# SPDX-License-Identifier: Apache-2.0
"""`tactile_msgs/TactileState`: one channel of numbers for each finger, named as the driver chooses.

The order of the numbers in a channel is not standardised: `state_pdc` and `state_electrodes` give the indices.
"""

from functools import partial
from typing import Any, Final

import numpy as np

from foretouch.errors import TactileError
from foretouch.tactile import ELECTRODES
from foretouch.tactile.messages.table import TactileConfig, TactileReader, TactileReading, stamp_ns

FINGERS: Final = ("TH", "MF")


def make_reader(config: TactileConfig) -> TactileReader:
    """The decoder for the chosen channels."""
    return TactileReader(partial(_read, config=config))


def _read(message: Any, config: TactileConfig) -> TactileReading:
    channels = {sensor.name: np.asarray(sensor.values, np.float32) for sensor in message.sensors}
    pdc, first = config.state_pdc, config.state_electrodes
    length = max(pdc + 1, first + ELECTRODES)
    for name in config.fingers:
        if name not in channels:
            raise TactileError(f"{name}: no such channel; there are {', '.join(map(repr, channels)) or 'none'}")
        if len(channels[name]) < length:
            raise TactileError(f"{name}: {len(channels[name])} values, {length} are needed")
    th, mf = (channels[name] for name in config.fingers)
    electrodes = slice(first, first + ELECTRODES)
    counts = np.concatenate([th[pdc : pdc + 1], mf[pdc : pdc + 1], th[electrodes], mf[electrodes]])
    if not np.isfinite(counts).all():
        raise TactileError("TactileState: a count is not finite")
    return TactileReading(stamp_ns(message.header.stamp), counts, np.empty(0, np.float32))
