# SPDX-License-Identifier: Apache-2.0
"""`BiotacAll` as the Shadow Hand's driver sends it, and the topic and classes of the supported tactile messages.

Tactile messages are decoded in `foretouch.tactile.messages`.
"""

import array
import importlib
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from foretouch.config import Settings, setting
from foretouch.errors import MissingDependencyError
from foretouch.ros.messages.conversions import header_to_msg
from foretouch.tactile import ELECTRODES
from foretouch.tactile.messages.biotac_all import FINGER_ORDER, OTHERS
from foretouch.tactile.messages.table import TactileConfig
from foretouch.topics import TACTILE_TOPIC
from foretouch_msgs.msg import Biotac, BiotacAll

Counts = npt.NDArray[np.int16]

_ABSENT: Counts = np.zeros(1 + ELECTRODES, np.int16)


@dataclass(frozen=True, kw_only=True)
class TactileInput(Settings):
    """Settings of nodes that receive tactile messages."""

    tactile_topic: str = setting(TACTILE_TOPIC, "Topic of the tactile messages", read_only=True)
    tactile: TactileConfig = field(default_factory=TactileConfig)


def biotac_all_to_msg(fingers: Mapping[str, Counts], frame_id: str, nanoseconds: int) -> BiotacAll:
    """A message of all five fingers with a frame and a stamp [ns].

    `fingers` holds (25,) int16 counts by finger, PDC then electrodes, or (29,) with PAC0, PAC1, TAC and TDC, which are
    0 otherwise. An absent finger sends zeros, as one without a BioTac does.
    """
    # rclpy takes over an array.array of the right type as it is; it checks any other sequence element by element.
    tactiles = [
        Biotac(
            pdc=int(counts[0]),
            electrodes=array.array("h", counts[1 : 1 + ELECTRODES].tobytes()),
            **{name.lower(): int(value) for name, value in zip(OTHERS, counts[1 + ELECTRODES :], strict=False)},
        )
        for counts in (fingers.get(name, _ABSENT) for name in FINGER_ORDER)
    ]
    return BiotacAll(header=header_to_msg(frame_id, nanoseconds), tactiles=tactiles)


def tactile_class(type_name: str) -> type:
    """The message class of a type such as `std_msgs/String`; a `MissingDependencyError` without its package."""
    package, _, name = type_name.partition("/")
    try:
        message: type = getattr(importlib.import_module(f"{package}.msg"), name)
    except (ImportError, AttributeError) as err:
        raise MissingDependencyError(
            f"{type_name}: {package} is not installed; source the workspace that holds it"
        ) from err
    return message
