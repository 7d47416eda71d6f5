# SPDX-License-Identifier: Apache-2.0
"""`tactile_msgs/TactileState`: one channel of numbers for each finger, PDC and the electrodes, named as the driver chooses."""

from collections.abc import Sequence
from functools import partial
from typing import Any, Final

import numpy as np

from foretouch.errors import TactileError
from foretouch.tactile import ELECTRODES
from foretouch.tactile.messages.table import TactileConfig, TactileReader, TactileReading, stamp_ns

FINGERS: Final = ("TH", "MF")


def make_reader(config: TactileConfig) -> TactileReader:
    """The decoder for the chosen channels."""
    return TactileReader(partial(_read, fingers=config.fingers))


def _read(message: Any, fingers: Sequence[str]) -> TactileReading:
    channels = {sensor.name: np.asarray(sensor.values, np.float32) for sensor in message.sensors}
    for name in fingers:
        if name not in channels:
            raise TactileError(f"{name}: no such channel; there are {', '.join(map(repr, channels)) or 'none'}")
        if len(channels[name]) <= ELECTRODES:
            raise TactileError(f"{name}: {len(channels[name])} values, {1 + ELECTRODES} are needed")
    th, mf = (channels[name][: 1 + ELECTRODES] for name in fingers)
    counts = np.concatenate([th[:1], mf[:1], th[1:], mf[1:]])
    if not np.isfinite(counts).all():
        raise TactileError("TactileState: a count is not finite")
    return TactileReading(stamp_ns(message.header.stamp), counts, np.empty(0, np.float32))
