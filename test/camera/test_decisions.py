# SPDX-License-Identifier: Apache-2.0
"""What is decided from times alone: which colour frame belongs to a depth frame, and when a camera is opened again."""

import pytest
from every_case import every_case

from foretouch.camera.config import TimeoutConfig
from foretouch.camera.realsense import _Watchdog
from foretouch.camera.stream import _ColourBuffer

_TIMEOUTS = TimeoutConfig(start_s=5.0, stall_s=1.0, reopen_s=3.0)


def _buffer(*stamps_ms: float) -> _ColourBuffer[float]:
    """At 30 Hz: a period is 33.3 ms."""
    buffer: _ColourBuffer[float] = _ColourBuffer(33.3, float)
    for stamp in stamps_ms:
        buffer.add(stamp)
    return buffer


def test_the_nearest_colour_within_six_tenths_of_a_period() -> None:
    def check(stamps: list[float], wanted: float, found: float | None, is_past: bool) -> None:
        assert _buffer(*stamps).nearest(wanted) == (found, is_past)

    cases = {
        "the same moment": ([0.0, 33.0, 66.0], 33.0, 33.0, True),
        "half a period off": ([10.0, 43.0], 33.0, 43.0, False),
        "a period off": ([0.0, 33.0], 66.0, None, False),
        "a later one is here": ([90.0], 66.0, None, True),
        "none": ([], 0.0, None, False),
    }
    every_case(cases, check)
    buffer = _buffer(0.0, 33.0, 66.0)  # what is too old is forgotten, what is later kept
    assert [buffer.nearest(stamp)[0] for stamp in (66.0, 33.0, 66.0)] == [66.0, None, 66.0]


def test_a_silent_camera_stalls_is_opened_again_and_pauses_double_until_a_frame_comes() -> None:
    dog = _Watchdog(_TIMEOUTS)
    dog.note(100.0, streaming=False)
    assert [dog.decide(100.0 + t) for t in (0.5, 4.9, 5.1)] == ["wait", "wait", "reopen"]
    dog.note(101.0, streaming=True)
    assert [dog.decide(101.0 + t) for t in (0.9, 1.1, 2.9, 3.1)] == ["wait", "stalled", "stalled", "reopen"]
    assert dog.silent_s(103.5) == 2.5
    assert [dog.failed(10.0) for _ in range(6)] == [0.5, 1.0, 2.0, 4.0, 8.0, 10.0]
    assert (dog.failures, dog.next_attempt_s) == (6, 20.0)
    dog.note(20.0, streaming=True)
    assert dog.failed(30.0) == 0.5
    dog.note(31.0, streaming=False)  # opening alone forgives nothing
    assert dog.failed(36.5) == 1.0
    dog.failures = 100_000  # absent for days
    assert (dog.failed(0.0), dog.next_attempt_s) == pytest.approx((10.0, 10.0))
