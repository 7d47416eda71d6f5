# SPDX-License-Identifier: Apache-2.0
"""Counts to `BiotacAll`, as the Shadow Hand's driver sends them: pure functions, no node."""

from __future__ import annotations

import array
from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from foretouch.ros.conversions import header_to_msg
from foretouch.types import ELECTRODES
from foretouch_msgs.msg import Biotac, BiotacAll

__all__ = ["FINGERS", "biotac_all_to_msg", "counts_from_msg"]

FINGERS = ("FF", "MF", "RF", "LF", "TH")
"""In the order of `BiotacAll`."""

Counts = npt.NDArray[np.int16]

_ABSENT: Counts = np.zeros(1 + ELECTRODES, np.int16)


def biotac_all_to_msg(fingers: Mapping[str, Counts], frame_id: str, nanoseconds: int) -> BiotacAll:
    """One message of the hand; vibration and temperature are not simulated and stay 0.

    Args:
        fingers: (25,) int16 counts by finger, PDC then electrodes. A finger that is not there sends zeros, as
            one without a BioTac does.
        frame_id: Of the header.
        nanoseconds: Its stamp [ns].
    """
    tactiles = [_biotac(fingers.get(name, _ABSENT)) for name in FINGERS]
    return BiotacAll(header=header_to_msg(frame_id, nanoseconds), tactiles=tactiles)


def counts_from_msg(message: BiotacAll, finger: str) -> Counts:
    """(1 + n,) int16: PDC, then the electrodes, of one finger."""
    tactile = message.tactiles[FINGERS.index(finger)]
    return np.array([tactile.pdc, *tactile.electrodes], np.int16)


def _biotac(counts: Counts) -> Biotac:
    # An array.array of the right type is taken over as it is; rclpy looks at any other sequence element by element.
    return Biotac(pdc=int(counts[0]), electrodes=array.array("h", counts[1:].tobytes()))
