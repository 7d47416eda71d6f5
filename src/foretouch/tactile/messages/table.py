# SPDX-License-Identifier: Apache-2.0
"""The supported types of tactile messages, and what every decoder of one gives.

To support another type, add a module with `FINGERS` (default names of thumb and middle finger) and
`make_reader(config)`, and a line to `TACTILE_TYPES`. The recorder, `dataset import`, the nodes and the help texts
take the supported types from that table.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Any, Final

from foretouch.config import Settings, setting
from foretouch.errors import ConfigError
from foretouch.types import Float32

#: Message type to the module that decodes it.
TACTILE_TYPES: dict[str, str] = {
    "foretouch_msgs/BiotacAll": "foretouch.tactile.messages.biotac_all",
    "sr_robot_msgs/BiotacAll": "foretouch.tactile.messages.biotac_all",
    "std_msgs/String": "foretouch.tactile.messages.biotac_csv",
    "tactile_msgs/TactileState": "foretouch.tactile.messages.tactile_state",
}

#: Flag of samples whose messages carry no stamp: the time of reception is taken instead.
ARRIVAL_STAMPED: Final = "arrival_stamped"

_SECOND_NS: Final = 1_000_000_000


@dataclass(frozen=True, kw_only=True)
class TactileConfig(Settings, read_only=True):
    """Type of the tactile messages, and which of their fingers are the thumb and the middle finger."""

    type: str = setting("foretouch_msgs/BiotacAll", "Type of the tactile messages", choices=TACTILE_TYPES)
    thumb: str = setting("", "Name of the thumb in the messages; empty for the type's default, TH or 0")
    middle: str = setting("", "Name of the middle finger in the messages; empty for the type's default, MF or 1")
    state_pdc: int = setting(0, "Index of PDC in a channel of TactileState", minimum=0)
    state_electrodes: int = setting(1, "Index of the first of 24 electrodes in a channel of TactileState", minimum=0)

    @property
    def fingers(self) -> tuple[str, str]:
        """Names of thumb and middle finger in the messages."""
        thumb, middle = import_module(TACTILE_TYPES[self.type]).FINGERS
        return self.thumb or thumb, self.middle or middle


@dataclass(frozen=True, eq=False)
class TactileReading:
    """The content of one tactile message."""

    stamp_ns: int | None  # stamp of its header [ns]; None where the type has none
    counts: Float32  # (50,) float32: PDC_TH, PDC_MF, E_TH, E_MF [counts]
    others: Float32  # (K,) float32, in the order of `TactileReader.others`


@dataclass(frozen=True)
class TactileReader:
    """Decoder of one type of tactile messages.

    Attributes:
        read: Decodes a message; raises `TactileError` where it holds no reading of a BioTac SP.
        others: Names of the channels beside PDC and electrodes, such as `TAC_TH`.
        flags: Flags of every sample with a touch from such messages.
    """

    read: Callable[[Any], TactileReading]
    others: tuple[str, ...] = ()
    flags: tuple[str, ...] = ()


def make_reader(config: TactileConfig) -> TactileReader:
    """The decoder for the settings; a `ConfigError` if the type has no finger of that name, or both are the same."""
    thumb, middle = config.fingers
    if thumb == middle:
        raise ConfigError(f"middle: {middle!r} is the thumb already")
    reader: TactileReader = import_module(TACTILE_TYPES[config.type]).make_reader(config)
    return reader


def named_index(name: str, names: Sequence[str], setting_name: str) -> int:
    """Index of a finger among the names that a type has; a `ConfigError` if the name is none of them."""
    if name not in names:
        raise ConfigError(f"{setting_name}: {name!r} is none of {', '.join(names)}")
    return names.index(name)


def stamp_ns(stamp: Any) -> int:
    """A `builtin_interfaces/Time` or `Duration` in integer nanoseconds."""
    return int(stamp.sec) * _SECOND_NS + int(stamp.nanosec)
