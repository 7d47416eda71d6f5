# SPDX-License-Identifier: Apache-2.0
"""The watchdog's decisions, on times written by hand."""

from __future__ import annotations

from foretouch.camera.config import TimeoutConfig
from foretouch.camera.realsense import Watchdog

_TIMEOUTS = TimeoutConfig(start_s=5.0, stall_s=1.0, reopen_s=3.0, backoff_min_s=0.5, backoff_max_s=4.0)


def test_a_camera_just_opened_may_take_its_time() -> None:
    dog = Watchdog(_TIMEOUTS)
    dog.opened(100.0)
    assert [dog.decide(100.0 + t) for t in (0.5, 4.9, 5.1)] == ["wait", "wait", "reopen"]


def test_a_streaming_camera_stalls_and_is_then_opened_again() -> None:
    dog = Watchdog(_TIMEOUTS)
    dog.opened(100.0)
    dog.frame(101.0)
    assert [dog.decide(101.0 + t) for t in (0.9, 1.1, 2.9, 3.1)] == ["wait", "stalled", "stalled", "reopen"]
    assert dog.silent_s(103.5) == 2.5


def test_pauses_double_up_to_the_longest_and_a_frame_forgives() -> None:
    dog = Watchdog(_TIMEOUTS)
    assert [dog.failed(10.0) for _ in range(5)] == [0.5, 1.0, 2.0, 4.0, 4.0]
    assert (dog.failures, dog.next_attempt_s) == (5, 14.0)
    dog.frame(20.0)
    assert dog.failed(30.0) == 0.5


def test_opening_alone_forgives_nothing() -> None:
    dog = Watchdog(_TIMEOUTS)
    dog.failed(10.0)
    dog.opened(11.0)
    assert dog.failed(16.5) == 1.0


def test_a_camera_absent_for_days_does_not_overflow() -> None:
    dog = Watchdog(_TIMEOUTS)
    dog.failures = 100_000
    assert dog.failed(0.0) == 4.0
