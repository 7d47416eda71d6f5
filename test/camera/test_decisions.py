# SPDX-License-Identifier: Apache-2.0
"""When a camera is opened again, decided from times alone."""

import pytest

from foretouch.camera.config import TimeoutConfig
from foretouch.camera.realsense import _Watchdog

_TIMEOUTS = TimeoutConfig(start_s=5.0, stall_s=1.0, reopen_s=3.0)


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
