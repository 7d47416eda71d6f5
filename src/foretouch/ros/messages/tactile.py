# SPDX-License-Identifier: Apache-2.0
"""Counts to `BiotacAll`, as the Shadow Hand's driver sends them: pure functions, no node.

Tactile messages of several drivers to the counts of thumb and middle finger: pure functions, no node.

| type | stamp | fingers are named |
|---|---|---|
| `foretouch_msgs/BiotacAll`, `sr_robot_msgs/BiotacAll` (the same fields) | header | FF, MF, RF, LF, TH |
| `std_msgs/String`, the CSV of `biotac_sp_ros` | none: arrival | place in the line: 0, 1, 2 |
| `tactile_msgs/TactileState` | header | name of the channel |

A line of `biotac_sp_ros` is a time, printed with six digits and so of no use, and 54 numbers for each of three
places: E1, PAC, E2, PAC, ... E24, PAC, PDC, PAC, TAC, PAC, TDC, PAC. How a driver fills a channel of `TactileState`
is its own affair: `state_pdc` and `state_electrodes` say where the counts stand.
"""

from __future__ import annotations

import array
import importlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from foretouch.config import Settings, setting
from foretouch.errors import ConfigError, MissingDependencyError, TactileError
from foretouch.ros.messages.conversions import header_to_msg, stamp_ns
from foretouch.types import ELECTRODES, TOUCH_SIZE, Float32
from foretouch_msgs.msg import Biotac, BiotacAll

__all__ = [
    "ARRIVAL_STAMPED",
    "FINGERS",
    "AdapterConfig",
    "TactileAdapter",
    "TactileReading",
    "biotac_all_to_msg",
    "counts_from_msg",
    "make_adapter",
]


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


ARRIVAL_STAMPED = "arrival_stamped"
_TYPES = ("foretouch_msgs/BiotacAll", "sr_robot_msgs/BiotacAll", "std_msgs/String", "tactile_msgs/TactileState")
_FINGERS_OF = {"std_msgs/String": ("0", "1")}  # as others name none, TH and MF
_PLACES = 3
_PER_PLACE = 54
_OTHERS = ("PAC0", "PAC1", "TAC", "TDC")


@dataclass(frozen=True, kw_only=True)
class AdapterConfig(Settings):
    """What the hand sends, and which of its fingers are which."""

    type: str = setting("foretouch_msgs/BiotacAll", "Type of the tactile messages", choices=_TYPES, read_only=True)
    thumb: str = setting("", "The finger that is the thumb; empty for the type's own: TH or place 0", read_only=True)
    middle: str = setting("", "The middle finger; empty for the type's own: MF or place 1", read_only=True)
    state_pdc: int = setting(0, "Where PDC stands in a channel of TactileState", minimum=0, read_only=True)
    state_electrodes: int = setting(
        1, "Where the 24 electrodes begin in a channel of TactileState", minimum=0, read_only=True
    )

    @property
    def fingers(self) -> tuple[str, str]:
        """Names of thumb and middle finger in the messages."""
        thumb, middle = _FINGERS_OF.get(self.type, ("TH", "MF"))
        return self.thumb or thumb, self.middle or middle


@dataclass(frozen=True, eq=False)
class TactileReading:
    """One message.

    Attributes:
        stamp_ns: Of its header [ns]; None where it has none.
        counts: (50,) float32: PDC_TH, PDC_MF, E_TH, E_MF.
        others: (K,) float32, in the order of `TactileAdapter.others`.
    """

    stamp_ns: int | None
    counts: Float32
    others: Float32


@dataclass(frozen=True)
class TactileAdapter:
    """How to read one type of message.

    Attributes:
        message: Its class.
        type_name: Such as `std_msgs/msg/String`.
        others: Names of the further channels.
        flags: That every sample from it carries.
        read: The message's counts; raises `TactileError` where it holds no reading of a BioTac SP.
    """

    message: type
    type_name: str
    others: tuple[str, ...]
    flags: tuple[str, ...]
    read: Callable[[Any], TactileReading]


def make_adapter(config: AdapterConfig) -> TactileAdapter:
    """The adapter of the settings.

    Raises:
        ConfigError: If a finger has no such name, or both are one.
        MissingDependencyError: If the type's package is not installed.
    """
    thumb, middle = config.fingers
    if thumb == middle:
        raise ConfigError(f"AdapterConfig.middle: {middle!r} is the thumb already")
    package, _, name = config.type.partition("/")
    try:
        message: type = getattr(importlib.import_module(f"{package}.msg"), name)
    except (ImportError, AttributeError) as err:
        raise MissingDependencyError(
            f"{config.type}: {package} is not installed; source the workspace that holds it"
        ) from err
    names = tuple(f"{channel}_{finger}" for finger in ("TH", "MF") for channel in _OTHERS)
    type_name = f"{package}/msg/{name}"
    if config.type == "std_msgs/String":
        places = (_place(thumb, "thumb"), _place(middle, "middle"))
        kept = tuple(name for name in names if name.startswith("T"))
        return TactileAdapter(message, type_name, kept, (ARRIVAL_STAMPED,), lambda m: _read_csv(m.data, *places))
    if config.type == "tactile_msgs/TactileState":
        return TactileAdapter(message, type_name, (), (), lambda m: read_state(m, config))
    indices = (_finger(thumb, "thumb"), _finger(middle, "middle"))
    return TactileAdapter(message, type_name, names, (), lambda m: _read_biotacs(m, *indices))


def _read_biotacs(message: Any, thumb: int, middle: int) -> TactileReading:
    th, mf = message.tactiles[thumb], message.tactiles[middle]
    counts = np.empty(TOUCH_SIZE, np.float32)
    counts[0], counts[1] = th.pdc, mf.pdc
    for place, tactile in ((2, th), (2 + ELECTRODES, mf)):
        if len(tactile.electrodes) != ELECTRODES:
            name = FINGERS[thumb if tactile is th else middle]
            raise TactileError(f"{name}: {len(tactile.electrodes)} electrodes, a BioTac SP has {ELECTRODES}")
        counts[place : place + ELECTRODES] = tactile.electrodes
    others = np.array([getattr(one, name.lower()) for one in (th, mf) for name in _OTHERS], np.float32)
    return TactileReading(stamp_ns(message.header.stamp), counts, others)


def _read_csv(text: str, thumb: int, middle: int) -> TactileReading:
    fields = text.split(",")
    if len(fields) != 1 + _PLACES * _PER_PLACE:
        raise TactileError(f"CSV: {len(fields)} fields, a line of biotac_sp_ros has {1 + _PLACES * _PER_PLACE}")
    try:
        values = np.array(fields[1:], np.float32).reshape(_PLACES, _PER_PLACE)[:, ::2]  # every second is PAC
    except ValueError as err:
        raise TactileError(f"CSV: {err}") from err
    th, mf = values[thumb], values[middle]
    e, pdc = slice(0, ELECTRODES), ELECTRODES
    counts = np.concatenate([th[pdc : pdc + 1], mf[pdc : pdc + 1], th[e], mf[e]])
    if not np.isfinite(counts).all():
        raise TactileError("CSV: a count is not finite")
    return TactileReading(None, counts, np.concatenate([th[pdc + 1 :], mf[pdc + 1 :]]))


def read_state(message: Any, config: AdapterConfig) -> TactileReading:
    """The counts in a `tactile_msgs/TactileState`.

    Raises:
        TactileError: If a channel is absent or too short, or holds a number that is not finite.
    """
    channels = {sensor.name: np.asarray(sensor.values, np.float32) for sensor in message.sensors}
    pdc, first = config.state_pdc, config.state_electrodes
    length = max(pdc + 1, first + ELECTRODES)
    values = []
    for name in config.fingers:
        if name not in channels:
            raise TactileError(f"{name}: no such channel; there are {', '.join(map(repr, channels)) or 'none'}")
        if len(channels[name]) < length:
            raise TactileError(f"{name}: {len(channels[name])} values, {length} are needed")
        values.append(channels[name])
    th, mf = values
    electrodes = slice(first, first + ELECTRODES)
    counts = np.concatenate([th[pdc : pdc + 1], mf[pdc : pdc + 1], th[electrodes], mf[electrodes]])
    if not np.isfinite(counts).all():
        raise TactileError("TactileState: a count is not finite")
    return TactileReading(stamp_ns(message.header.stamp), counts, np.empty(0, np.float32))


def _finger(name: str, which: str) -> int:
    if name not in FINGERS:
        raise ConfigError(f"AdapterConfig.{which}: {name!r} is none of {', '.join(FINGERS)}")
    return FINGERS.index(name)


def _place(name: str, which: str) -> int:
    if name not in map(str, range(_PLACES)):
        raise ConfigError(f"AdapterConfig.{which}: {name!r} is none of {', '.join(map(str, range(_PLACES)))}")
    return int(name)
