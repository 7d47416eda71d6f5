# SPDX-License-Identifier: Apache-2.0
"""The box between the library's thread and the reader."""

from __future__ import annotations

import threading
import time

import pytest

from foretouch.camera.frame_queue import FrameQueue


def test_a_lossy_box_keeps_the_newest() -> None:
    box: FrameQueue[int] = FrameQueue(2, lossless=False)
    box.bound()
    for item in range(5):
        box.put(item)
    assert [box.get(0.0) for _ in range(3)] == [3, 4, None]


def test_a_lossless_box_makes_the_sender_wait() -> None:
    box: FrameQueue[int] = FrameQueue(1, lossless=True)
    box.bound()
    sender = threading.Thread(target=lambda: [box.put(item) for item in range(20)])
    sender.start()
    got = []
    for _ in range(20):
        time.sleep(0.002)
        got.append(box.get(1.0))
    sender.join(1.0)
    assert got == list(range(20))
    assert not sender.is_alive()


@pytest.mark.parametrize("lossless", [True, False])
def test_until_it_is_bound_a_box_takes_all_at_once(lossless: bool) -> None:
    box: FrameQueue[int] = FrameQueue(1, lossless=lossless)
    for item in range(3):
        box.put(item)
    assert [box.get(0.0) for _ in range(3)] == [0, 1, 2]


def test_closing_lets_a_waiting_sender_go() -> None:
    box: FrameQueue[int] = FrameQueue(1, lossless=True)
    box.bound()
    box.put(0)
    sender = threading.Thread(target=box.put, args=(1,), daemon=True)
    sender.start()
    time.sleep(0.05)
    assert sender.is_alive()
    box.close()
    sender.join(1.0)
    assert not sender.is_alive()
    assert box.get(0.0) is None


def test_an_empty_box_is_waited_for_no_longer_than_asked() -> None:
    started = time.monotonic()
    assert FrameQueue[int](1, lossless=False).get(0.1) is None
    assert 0.09 < time.monotonic() - started < 0.5
