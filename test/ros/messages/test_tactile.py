# SPDX-License-Identifier: Apache-2.0
"""Messages of several drivers to the same 50 counts."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from sensor_msgs.msg import ChannelFloat32
from std_msgs.msg import String

from foretouch.errors import ConfigError, MissingDependencyError, TactileError
from foretouch.ros.messages.conversions import header_to_msg
from foretouch.ros.messages.tactile import FINGERS, AdapterConfig, biotac_all_to_msg, make_adapter, read_state

STAMP = 1_700_000_000_123_456_789


def finger(k: int) -> np.ndarray:
    """(25,) counts that tell the finger: PDC, then electrodes."""
    return (1000 * (k + 1) + np.arange(25)).astype(np.int16)


def expected(thumb: int, middle: int) -> np.ndarray:
    th, mf = finger(thumb), finger(middle)
    return np.r_[th[0], mf[0], th[1:], mf[1:]]


def line(places: int = 3) -> str:
    """As biotac_sp_ros prints it; PAC is -1 everywhere."""
    numbers: list[float] = []
    for k in range(places):
        pdc, electrodes = finger(k)[0], finger(k)[1:]
        for value in (*electrodes, pdc, 50 + k, 60 + k):  # TAC, TDC
            numbers += [value, -1]
    return ",".join(["1.70000e+09", *map(str, numbers)])


def test_biotac_all_by_the_names_of_its_fingers() -> None:
    message = biotac_all_to_msg({name: finger(k) for k, name in enumerate(FINGERS)}, "rh", STAMP)
    message.tactiles[4].pac0, message.tactiles[1].tdc = 7, 9
    adapter = make_adapter(AdapterConfig())
    reading = adapter.read(message)
    np.testing.assert_array_equal(reading.counts, expected(4, 1))
    assert reading.stamp_ns == STAMP
    others = dict(zip(adapter.others, reading.others, strict=True))
    assert (others["PAC0_TH"], others["TDC_MF"], others["TAC_TH"]) == (7, 9, 0)
    assert adapter.flags == ()
    swapped = make_adapter(AdapterConfig(thumb="FF", middle="RF")).read(message)
    np.testing.assert_array_equal(swapped.counts, expected(0, 2))


def test_a_biotac_that_is_no_sp_is_refused_by_name() -> None:
    message = biotac_all_to_msg({name: finger(k) for k, name in enumerate(FINGERS)}, "rh", STAMP)
    message.tactiles[1].electrodes = [1] * 19
    with pytest.raises(TactileError, match="MF: 19 electrodes, a BioTac SP has 24"):
        make_adapter(AdapterConfig()).read(message)


def test_the_csv_of_biotac_sp_ros_has_no_stamp_and_says_so() -> None:
    adapter = make_adapter(AdapterConfig(type="std_msgs/String"))
    reading = adapter.read(String(data=line()))
    np.testing.assert_array_equal(reading.counts, expected(0, 1))
    assert reading.stamp_ns is None
    assert adapter.flags == ("arrival_stamped",)
    assert dict(zip(adapter.others, reading.others, strict=True)) == {
        "TAC_TH": 50,
        "TDC_TH": 60,
        "TAC_MF": 51,
        "TDC_MF": 61,
    }
    other = make_adapter(AdapterConfig(type="std_msgs/String", thumb="2", middle="0")).read(String(data=line()))
    np.testing.assert_array_equal(other.counts, expected(2, 0))


@pytest.mark.parametrize(
    ("text", "rule"),
    [
        ("", "1 fields, a line of biotac_sp_ros has 163"),
        (line(2), "109 fields"),
        (line().replace(",1001", ",x", 1), "could not convert"),
        (line().replace(",1001", ",nan", 1), "not finite"),
    ],
)
def test_lines_that_are_none_are_refused(text: str, rule: str) -> None:
    with pytest.raises(TactileError, match=rule):
        make_adapter(AdapterConfig(type="std_msgs/String")).read(String(data=text))


def state(**channels: Any) -> Any:
    sensors = [ChannelFloat32(name=name, values=[float(v) for v in values]) for name, values in channels.items()]
    return SimpleNamespace(header=header_to_msg("rh", STAMP), sensors=sensors)


def test_channels_of_a_tactile_state_by_name_and_place() -> None:
    config = AdapterConfig(type="tactile_msgs/TactileState", thumb="rh_th", middle="rh_mf")
    reading = read_state(state(rh_ff=finger(0), rh_mf=finger(1), rh_th=finger(4)), config)
    np.testing.assert_array_equal(reading.counts, expected(4, 1))
    assert reading.stamp_ns == STAMP
    last = AdapterConfig(type="tactile_msgs/TactileState", state_pdc=24, state_electrodes=0)
    turned = {name: np.roll(finger(k), -1) for name, k in (("TH", 4), ("MF", 1))}
    np.testing.assert_array_equal(read_state(state(**turned), last).counts, expected(4, 1))
    with pytest.raises(TactileError, match="TH: no such channel; there are 'rh_th'"):
        read_state(state(rh_th=finger(4)), last)
    with pytest.raises(TactileError, match="TH: 20 values, 25 are needed"):
        read_state(state(TH=finger(4)[:20], MF=finger(1)), last)


def test_names_that_mean_no_finger_and_packages_that_are_not_there() -> None:
    for config, rule in (
        (AdapterConfig(thumb="thumb"), "thumb: 'thumb' is none of FF, MF, RF, LF, TH"),
        (AdapterConfig(type="std_msgs/String", middle="3"), "middle: '3' is none of 0, 1, 2"),
        (AdapterConfig(thumb="MF"), "middle: 'MF' is the thumb already"),
    ):
        with pytest.raises(ConfigError, match=rule):
            make_adapter(config)
    with pytest.raises(MissingDependencyError, match="sr_robot_msgs is not installed"):
        make_adapter(AdapterConfig(type="sr_robot_msgs/BiotacAll"))
