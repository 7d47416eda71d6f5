# SPDX-License-Identifier: Apache-2.0
"""Readings whose stamps repeat, come in the wrong order or from a clock that is set; clouds bounded in time and memory."""

from types import SimpleNamespace

import numpy as np
from pair_builders import NONE, PERIOD, REST, SECOND, T0

from foretouch.cloud.messages import cloud_fields, decode_objects
from foretouch.dataset.labelling.buffers import CloudBuffer, SeenObjects, TouchBuffer
from foretouch.tactile.messages.table import TactileReading
from foretouch.types import Cloud


def feed(buffer: TouchBuffer, *stamps: int) -> None:
    for stamp in stamps:
        buffer.add(TactileReading(stamp, REST, NONE, stamp))


def kept(buffer: TouchBuffer) -> list[int]:
    return buffer.between(0, 2**62).stamps_ns.tolist()


def cloud(stamp: int, data: bytes, x: float | None = None) -> SeenObjects:
    """A message of these bytes with points at an x [m], by default the first byte."""
    xyz = np.full((5, 3), data[0] if x is None else x, np.float32)
    return SeenObjects(stamp, lambda: decode_objects(cloud_fields(Cloud(xyz, frame_id="lens"))), len(data), data)


def test_order_is_that_of_the_stamps_and_memory_is_bounded_in_time_and_in_number(monkeypatch) -> None:
    buffer, stamps = TouchBuffer(), [T0 + k * PERIOD for k in range(200)]
    feed(buffer, *(stamps[k ^ 3] for k in range(200)))
    assert kept(buffer) == stamps
    assert buffer.newest_ns == stamps[-1]
    assert dict(buffer.anomalies) == {"out_of_order": 150}  # three of each four came late
    buffer = TouchBuffer()
    feed(buffer, T0, T0, T0 + PERIOD)
    assert kept(buffer) == [T0, T0, T0 + PERIOD]
    assert dict(buffer.anomalies) == {"duplicate_stamp": 1}
    buffer = TouchBuffer(kept_s=5.0)
    feed(buffer, *(T0 + k * PERIOD for k in range(2000)))
    assert 500 <= len(buffer) <= 600
    monkeypatch.setattr("foretouch.dataset.labelling.buffers._MAX_READINGS", 300)
    crowded = TouchBuffer(kept_s=1e6)
    feed(crowded, *(T0 + k for k in range(2000)))
    assert len(crowded) == 300
    assert kept(crowded)[-1] == T0 + 1999
    assert np.all(np.diff(kept(crowded)) == 1)


def test_wrong_stamps_are_left_out_a_clock_set_back_forgets_and_accepted_readings_are_passed_on() -> None:
    hour, back, later = 3600 * SECOND, T0 - 100 * SECOND, T0 + 10 * SECOND
    steps = [k * PERIOD for k in range(50)]
    for stamps, expected, anomaly in (
        ([T0, T0 - hour, T0 + PERIOD, T0 + 2 * PERIOD], [T0, T0 + PERIOD, T0 + 2 * PERIOD], "wrong_stamp"),
        ([T0, T0 + hour, T0 + PERIOD, T0 + 2 * PERIOD], [T0, T0 + PERIOD, T0 + 2 * PERIOD], "wrong_stamp"),
        ([T0 + k for k in steps] + [back + k for k in steps], [back + k for k in steps], "clock_jump"),
        ([T0, T0 + PERIOD, later, later + PERIOD], [T0, T0 + PERIOD, later, later + PERIOD], "stamp_gap"),  # a pause
    ):
        buffer = TouchBuffer()
        feed(buffer, *stamps)
        assert kept(buffer) == expected
        assert dict(buffer.anomalies) == {anomaly: 1}
    future, back = T0 + 1000 * SECOND, T0 - 1000 * SECOND
    stamps = [T0, future, T0 + PERIOD, back, future, T0 + 2 * PERIOD, future, future + PERIOD, T0, T0 + PERIOD]
    buffer = TouchBuffer()
    passed = [[one.stamp_ns for one in buffer.add(TactileReading(stamp, REST, NONE, stamp))] for stamp in stamps]
    assert passed == [
        [T0], [], [T0 + PERIOD], [], [], [T0 + 2 * PERIOD], [], [future, future + PERIOD], [], [T0, T0 + PERIOD]
    ]  # fmt: skip
    assert dict(buffer.anomalies) == {"wrong_stamp": 3, "stamp_gap": 1, "clock_jump": 1}


def test_the_oldest_clouds_go_and_the_same_message_twice_is_one_but_two_of_one_stamp_neither() -> None:
    clouds = CloudBuffer(kept_s=10.0, kept_mb=1.0)
    assert clouds.add(cloud(1, b"a"), 0.0) == clouds.add(cloud(2, b"b"), 9.0) == []
    assert [gone.stamp_ns for gone in clouds.add(cloud(3, b"c"), 10.5)] == [1]
    assert clouds.get(1) is None
    assert clouds.get(2).data == b"b"
    clouds = CloudBuffer(kept_s=1e6, kept_mb=1.0)
    gone = [one.stamp_ns for k in range(10) for one in clouds.add(cloud(k, bytes(300_000)), 0.0)]
    assert gone == list(range(7))
    assert (len(clouds), clouds.bytes) == (3, 900_000)
    assert [one.stamp_ns for one in clouds.clear()] == [7, 8, 9]
    assert (len(clouds), clouds.bytes) == (0, 0)
    clouds = CloudBuffer(10.0, 1.0)
    clouds.add(cloud(1, b"a"), 0.0)
    for data, x in ((b"a", None), (b"b", ord("a")), (b"b", ord("a") + 1e-6), (b"a", 1.0)):
        clouds.add(cloud(1, data, x), 0.1)  # the same bytes, or the same points, if rounded
        assert not clouds.get(1).ambiguous
    clouds.add(cloud(1, b"b"), 0.2)
    assert clouds.get(1).ambiguous
    short = cloud_fields(Cloud(np.zeros((5, 3), np.float32), frame_id="lens"))
    unreadable = SeenObjects(2, lambda: decode_objects(SimpleNamespace(**{**vars(short), "width": 7})), 1, b"c")
    clouds.add(cloud(2, b"d"), 0.2)
    clouds.add(unreadable, 0.2)
    assert clouds.get(2).ambiguous
    assert clouds.bytes == 2
