# SPDX-License-Identifier: Apache-2.0
"""`BiotacAll` of the Shadow Hand's driver, as in `foretouch_msgs` and, with the same fields, in `sr_robot_msgs`."""

from functools import partial
from typing import Any, Final

import numpy as np

from foretouch.errors import TactileError
from foretouch.tactile import ELECTRODES
from foretouch.tactile.messages.table import TactileConfig, TactileReader, TactileReading, named_index, stamp_ns
from foretouch.types import Float32

FINGERS: Final = ("TH", "MF")
FINGER_ORDER: Final = ("FF", "MF", "RF", "LF", "TH")  # order of the fingers in `tactiles`

OTHERS: Final = ("PAC0", "PAC1", "TAC", "TDC")


def finger_counts(message: Any, finger: str) -> Float32:
    """(1 + n,) float32 counts of one finger: PDC, then the electrodes."""
    tactile = message.tactiles[FINGER_ORDER.index(finger)]
    return np.array([tactile.pdc, *tactile.electrodes], np.float32)


def make_reader(config: TactileConfig) -> TactileReader:
    """The decoder for the chosen fingers (raises `ConfigError` for names that are not in `FINGER_ORDER`)."""
    names = zip(config.fingers, ("thumb", "middle"), strict=True)
    fingers = tuple(FINGER_ORDER[named_index(name, FINGER_ORDER, which)] for name, which in names)
    others = tuple(f"{channel}_{finger}" for finger in FINGERS for channel in OTHERS)
    return TactileReader(partial(_read, fingers=fingers), others)


def _read(message: Any, fingers: tuple[str, ...]) -> TactileReading:
    thumb, middle = (finger_counts(message, finger) for finger in fingers)
    for finger, counts in zip(fingers, (thumb, middle), strict=True):
        if len(counts) != 1 + ELECTRODES:
            raise TactileError(f"{finger}: {len(counts) - 1} electrodes, a BioTac SP has {ELECTRODES}")
    tactiles = [message.tactiles[FINGER_ORDER.index(finger)] for finger in fingers]
    others = np.array([getattr(one, name.lower()) for one in tactiles for name in OTHERS], np.float32)
    counts = np.concatenate([thumb[:1], middle[:1], thumb[1:], middle[1:]])
    return TactileReading(stamp_ns(message.header.stamp), counts, others)
