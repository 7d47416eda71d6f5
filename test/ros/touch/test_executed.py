# SPDX-License-Identifier: Apache-2.0
"""What is cut out of the tactile stream, by header stamps and not by arrival."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from foretouch.ros.touch.executed import TactileWindow

from foretouch.ros.messages.conversions import header_to_msg, stamp_ns, stamp_to_msg
from foretouch.ros.messages.tactile import FINGERS, biotac_all_to_msg, counts_from_msg
from foretouch_msgs.msg import BiotacAll, ExecutedGrasp

MS = 1_000_000
START = 1_763_000_000_000_000_000


def message(k: int, *, value: int | None = None) -> BiotacAll:
    """The k-th of a stream at 100 Hz; its counts tell which it is."""
    thumb = np.full(25, 1000 + k if value is None else value, np.int16)
    return biotac_all_to_msg({"TH": thumb, "MF": (thumb + 500).astype(np.int16)}, "hand", START + 10 * MS * k)


def report(start: int, contact: int, release: int, *, success: bool = True) -> ExecutedGrasp:
    times = [stamp_to_msg(START + 10 * MS * k) for k in (start, contact, release)]
    return ExecutedGrasp(
        header=header_to_msg("camera", START),
        grasp_id="g",
        start=times[0],
        contact=times[1],
        release=times[2],
        success=success,
    )


def filled(messages: list[BiotacAll]) -> TactileWindow:
    window = TactileWindow()
    for one in messages:
        window.add(one)
    return window


def test_the_medians_of_rest_and_hold_whatever_the_order_of_arrival(rng: np.random.Generator) -> None:
    messages = [message(k) for k in range(200)]
    rng.shuffle(messages)
    felt = filled(messages).felt(report(100, 140, 161))
    assert felt is not None
    assert (felt.touch.pdc_th, felt.touch.pdc_mf) == (1150.0, 1650.0)  # 140 to 160
    assert felt.tare.pdc_th == pytest.approx(1084.5)  # 70 to 99
    np.testing.assert_array_equal(felt.touch.e_mf, np.full(24, 1650.0))


def test_nothing_is_made_up() -> None:
    stream = [message(k) for k in range(200)]
    assert filled(stream).felt(report(100, 140, 160, success=False)) is None
    assert filled(stream[:120]).felt(report(100, 140, 160)) is None
    assert filled([message(k, value=0) for k in range(200)]).felt(report(100, 140, 160)) is None


def test_messages_hold_each_finger_in_its_place() -> None:
    counts = {name: np.arange(25, dtype=np.int16) + 100 * k for k, name in enumerate(("TH", "FF"))}
    sent = biotac_all_to_msg(counts, "hand", START)
    assert (sent.header.frame_id, stamp_ns(sent.header.stamp)) == ("hand", START)
    assert [list(one.electrodes[:2]) for one in sent.tactiles] == [[101, 102], [0, 0], [0, 0], [0, 0], [1, 2]]
    for name in FINGERS:
        np.testing.assert_array_equal(counts_from_msg(sent, name), counts.get(name, np.zeros(25)))
