# SPDX-License-Identifier: Apache-2.0
"""The supported types of tactile messages, their settings, and what every decoder of one gives; `readers` makes them.

To support another type, add a line to `TACTILE_TYPES`, a module with `make_reader(config)`, and its line in `readers`. The
recorder, `dataset import`, the nodes and the help texts take the supported types from the table. Messages of a described
sensor need neither (see `described`).
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Final

from foretouch.config import Settings, setting
from foretouch.tactile.channels import BIOTAC_SP
from foretouch.tactile.description import Sensor, load_sensor, require_two
from foretouch.types import Float32
from foretouch.types.channels import Channels

#: Names of thumb and middle finger, by message type.
TACTILE_TYPES: dict[str, tuple[str, str]] = {
    "foretouch_msgs/BiotacAll": ("TH", "MF"),
    "sr_robot_msgs/BiotacAll": ("TH", "MF"),
    "std_msgs/String": ("0", "1"),
    "tactile_msgs/TactileState": ("TH", "MF"),
}

#: Flag of samples whose messages carry no stamp: the time of reception is taken instead.
ARRIVAL_STAMPED: Final = "arrival_stamped"


@dataclass(frozen=True, kw_only=True)
class TactileConfig(Settings, read_only=True):
    """Type of the tactile messages, and which of their fingers are the thumb and the middle finger."""

    type: str = setting("foretouch_msgs/BiotacAll", "Type of the tactile messages", choices=TACTILE_TYPES)
    sensor: str = setting(
        "", "Description of the sensor, a YAML file or the name of one of the package, with the type of its messages; "
        "empty for a BioTac SP by `type`",
    )  # fmt: skip
    thumb: str = setting(
        "", "Name of the finger at g1 in the messages; empty for the default of the type, TH or 0, or of the sensor"
    )
    middle: str = setting(
        "", "Name of the finger at g2 in the messages; empty for the default of the type, MF or 1, or of the sensor"
    )

    @cached_property
    def described(self) -> Sensor:
        """The sensor; a `ConfigError` if its description is absent or breaks a rule."""
        if not self.sensor:
            return BIOTAC_SP
        return require_two(load_sensor(self.sensor))

    @property
    def message_type(self) -> str:
        """Type of the messages; if a sensor is named, its description states it."""
        return self.described.config.source.type if self.sensor else self.type

    @property
    def fingers(self) -> tuple[str, str]:
        """Names of the fingers at g1 and g2 in the messages; a `ConfigError` for a faulty description."""
        if self.sensor:
            thumb, middle = self.described.channels.fingers
        else:
            thumb, middle = TACTILE_TYPES[self.type]
        return self.thumb or thumb, self.middle or middle


@dataclass(frozen=True, eq=False)
class TactileReading:
    """One reading of the fingers, as a tactile message holds it."""

    stamp_ns: int | None  # stamp of its header [ns]; None where the type has none
    counts: Float32  # (D,) float32 in the order of the sensor's channels; NaN of a finger that was not read
    others: Float32  # (K,) float32, in the order of `TactileReader.others`
    received_ns: int = 0  # when the message was received, by the clock of the stamps [ns]
    invalid: Mapping[str, int] = field(default_factory=dict)  # taxels that are not valid, by reason

    @property
    def time_ns(self) -> int:
        """The stamp, or the time of reception where the type has none [ns]."""
        return self.received_ns if self.stamp_ns is None else self.stamp_ns


@dataclass(frozen=True)
class TactileReader:
    """Decoder of one type of tactile messages.

    Attributes:
        read: Decodes a message; raises `TactileError` where it holds no reading of the sensor.
        others: Names of what a finger sends besides the values of a touch, such as `TAC_TH`.
        flags: Flags of every sample with a touch from such messages.
        sensor: What is read.
    """

    read: Callable[[Any], TactileReading]
    others: tuple[str, ...] = ()
    flags: tuple[str, ...] = ()
    sensor: Sensor = BIOTAC_SP

    @property
    def channels(self) -> Channels:
        """The values of a touch."""
        return self.sensor.channels

    @property
    def temperatures(self) -> frozenset[str]:
        """Those of `others` that contact does not change, such as `TDC_TH`, which samples state besides the touch."""
        names = [scalar.name for scalar in self.sensor.config.scalars if scalar.contact == "none"]
        return frozenset(f"{name}_{finger}" for name in names for finger in self.channels.fingers)
