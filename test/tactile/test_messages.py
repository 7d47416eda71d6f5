# SPDX-License-Identifier: Apache-2.0
"""Messages of several drivers are decoded to the same 50 counts, without ROS."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from every_case import every_refusal

from foretouch.errors import ConfigError, TactileError
from foretouch.tactile.messages.readers import make_reader
from foretouch.tactile.messages.table import TACTILE_TYPES, TactileConfig

STAMP = 1_700_000_000_123_456_789


def finger(k: int) -> np.ndarray:
    """(25,) counts that tell the finger: PDC, then electrodes."""
    return (1000 * (k + 1) + np.arange(25)).astype(np.int16)


def expected(thumb: int, middle: int) -> np.ndarray:
    th, mf = finger(thumb), finger(middle)
    return np.r_[th[0], mf[0], th[1:], mf[1:]]


def header() -> SimpleNamespace:
    return SimpleNamespace(stamp=SimpleNamespace(sec=STAMP // 10**9, nanosec=STAMP % 10**9))


def biotac_all() -> Any:
    others = {"pac0": 0, "pac1": 0, "tac": 0, "tdc": 0}
    tactiles = [SimpleNamespace(pdc=finger(k)[0], electrodes=finger(k)[1:], **others) for k in range(5)]
    return SimpleNamespace(header=header(), tactiles=tactiles)


def line(places: int = 3) -> str:
    """As biotac_sp_ros prints it; PAC is -1 everywhere."""
    numbers: list[float] = []
    for k in range(places):
        pdc, electrodes = finger(k)[0], finger(k)[1:]
        for value in (*electrodes, pdc, 50 + k, 60 + k):  # TAC, TDC
            numbers += [value, -1]
    return ",".join(["1.70000e+09", *map(str, numbers)])


def test_biotac_all_by_the_names_of_its_fingers_and_one_that_is_no_sp() -> None:
    message = biotac_all()
    message.tactiles[4].pac0, message.tactiles[1].tdc = 7, 9
    reader = make_reader(TactileConfig())
    reading = reader.read(message)
    np.testing.assert_array_equal(reading.counts, expected(4, 1))
    assert reading.stamp_ns == STAMP
    others = dict(zip(reader.others, reading.others, strict=True))
    assert (others["PAC0_TH"], others["TDC_MF"], others["TAC_TH"]) == (7, 9, 0)
    assert reader.flags == ()
    swapped = make_reader(TactileConfig(thumb="FF", middle="RF")).read(message)
    np.testing.assert_array_equal(swapped.counts, expected(0, 2))
    message.tactiles[1].electrodes = [1] * 19
    with pytest.raises(TactileError, match="MF: 19 electrodes, a BioTac SP has 24"):
        make_reader(TactileConfig()).read(message)


def test_the_csv_of_biotac_sp_ros_has_no_stamp_and_says_so() -> None:
    reader = make_reader(TactileConfig(type="std_msgs/String"))
    reading = reader.read(SimpleNamespace(data=line()))
    np.testing.assert_array_equal(reading.counts, expected(0, 1))
    assert reading.stamp_ns is None
    assert reader.flags == ("arrival_stamped",)
    others = dict(zip(reader.others, reading.others, strict=True))
    assert others == {"TAC_TH": 50, "TDC_TH": 60, "TAC_MF": 51, "TDC_MF": 61}
    other = make_reader(TactileConfig(type="std_msgs/String", thumb="2", middle="0")).read(SimpleNamespace(data=line()))
    np.testing.assert_array_equal(other.counts, expected(2, 0))
    cases = (
        ("1 fields, a line of biotac_sp_ros has 163", ""),
        ("109 fields", line(2)),
        ("could not convert", line().replace(",1001", ",x", 1)),
        ("not finite", line().replace(",1001", ",nan", 1)),
    )
    every_refusal(TactileError, cases, lambda text: reader.read(SimpleNamespace(data=text)))


def state(**channels: Any) -> Any:
    sensors = [SimpleNamespace(name=name, values=[float(v) for v in values]) for name, values in channels.items()]
    return SimpleNamespace(header=header(), sensors=sensors)


def test_channels_of_a_tactile_state_by_name_and_place() -> None:
    config = TactileConfig(type="tactile_msgs/TactileState", thumb="rh_th", middle="rh_mf")
    reading = make_reader(config).read(state(rh_ff=finger(0), rh_mf=finger(1), rh_th=finger(4)))
    np.testing.assert_array_equal(reading.counts, expected(4, 1))
    assert reading.stamp_ns == STAMP
    cases = (
        ("TH: no such channel; there are 'rh_th'", {"rh_th": finger(4)}),
        ("TH: 20 values, 25 are needed", {"TH": finger(4)[:20], "MF": finger(1)}),
        ("TactileState: a count is not finite", {"TH": np.r_[finger(4)[:24], np.nan], "MF": finger(1)}),
    )
    every_refusal(
        TactileError,
        cases,
        lambda channels: make_reader(TactileConfig(type="tactile_msgs/TactileState")).read(state(**channels)),
    )


def test_names_of_no_finger_and_types_that_are_not_supported_are_refused() -> None:
    cases = (
        ("thumb: 'thumb' is not one of FF, MF, RF, LF, TH", {"thumb": "thumb"}),
        ("middle: '3' is not one of 0, 1, 2", {"type": "std_msgs/String", "middle": "3"}),
        ("middle: 'MF' is the thumb already", {"thumb": "MF"}),
        (r"type: 'x' is not one of foretouch_msgs/BiotacAll, sr_robot", {"type": "x"}),
    )
    every_refusal(ConfigError, cases, lambda settings: make_reader(TactileConfig(**settings)))
    assert all(make_reader(TactileConfig(type=name)) for name in TACTILE_TYPES)
