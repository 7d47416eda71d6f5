# SPDX-License-Identifier: Apache-2.0
"""The simulated hand's messages of a described sensor are read by the decoder of the same description."""

import sys
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from every_case import every_case
from sensor_builders import XELA_TYPES

from foretouch.errors import MissingDependencyError
from foretouch.ros.messages.tactile import message_class
from foretouch.tactile.description import packaged_sensor, sensor_files
from foretouch.tactile.messages.readers import make_reader
from foretouch.tactile.messages.table import TactileConfig
from foretouch_lab.ros.hand_messages import sensor_to_msg

pytestmark = pytest.mark.ros

TYPES = {
    **XELA_TYPES,
    "tactile_msgs/msg/TactileState": "std_msgs/Header header\nsensor_msgs/ChannelFloat32[] sensors\n",
    "sr_robot_msgs/msg/MSTPalm": "std_msgs/Header header\nsr_robot_msgs/MSTFinger[] fingers\n",
    "sr_robot_msgs/msg/MSTFinger": "sr_robot_msgs/MSTSensor[] sensors\n",
    "sr_robot_msgs/msg/MSTSensor": "int16 magnetic_induction_x\nint16 magnetic_induction_y\nint16 magnetic_induction_z\n"
    "uint16 temperature\n",
}
STAMP = 1_700_000_000_250_000_000


def use_types(monkeypatch: pytest.MonkeyPatch) -> None:
    """Classes with the fields and types of these messages, as rosidl makes them, so that no package must be built."""
    for name, text in TYPES.items():
        package, _, kind = name.split("/")
        module = sys.modules.get(f"{package}.msg") or ModuleType(f"{package}.msg")
        monkeypatch.setitem(sys.modules, package, ModuleType(package))
        monkeypatch.setitem(sys.modules, f"{package}.msg", module)
        fields = dict(reversed(line.split()) for line in text.splitlines())
        types = {key: f"sequence<{field[:-2]}>" if field.endswith("[]") else field for key, field in fields.items()}
        monkeypatch.setattr(module, kind, _class(kind, types), raising=False)


def _class(name: str, types: dict[str, str]) -> type:
    def begin(self: Any) -> None:
        for key, kind in types.items():
            setattr(self, key, [] if "<" in kind else message_class(kind)() if "/" in kind else 0)

    return type(name, (), {"__init__": begin, "get_fields_and_field_types": lambda _: types})


def test_every_described_sensor_is_read_back_with_its_stamp(monkeypatch: pytest.MonkeyPatch) -> None:
    use_types(monkeypatch)

    def check(name: str) -> None:
        sensor, rng = packaged_sensor(name), np.random.default_rng(0)
        channels = sensor.channels
        touch = rng.uniform(channels.low, np.minimum(channels.high, 4000.0))
        touch = np.where(channels.resolution == 1.0, np.round(touch), touch.astype(np.float32))
        readings = [touch[columns] for columns in channels.finger_columns.values()]
        message = sensor_to_msg(message_class(sensor.config.source.type), sensor, readings, STAMP)
        found = make_reader(TactileConfig(sensor=name)).read(message)
        np.testing.assert_array_equal(found.counts, touch)
        assert found.stamp_ns == STAMP
        assert not found.invalid

    sources = {name: packaged_sensor(name).config.source.type for name in sensor_files()}
    every_case([(name,) for name, kind in sources.items() if kind != "table/Rows"], check)  # tables are no messages


def test_a_sensor_whose_messages_are_not_installed_is_named() -> None:
    with pytest.raises(MissingDependencyError, match="xela_server_ros2 is not installed"):
        message_class(packaged_sensor("xela_uskin_4x4").config.source.type)
