# SPDX-License-Identifier: Apache-2.0
"""The queue between threads: what is kept, what is dropped, and who waits."""

import threading
import time
from collections import Counter
from collections.abc import Callable

import numpy as np

from foretouch import bounded_queue
from foretouch.bounded_queue import BoundedQueue


def test_a_full_queue_drops_its_oldest_items_or_rejects_new_ones_and_one_without_a_capacity_none() -> None:
    dropped: list[tuple[int, str]] = []
    queue = BoundedQueue[int](2, on_drop=lambda item, reason: dropped.append((item, reason)))
    assert all(queue.put(item) for item in range(5))
    assert dropped == [(0, "superseded"), (1, "superseded"), (2, "superseded")]
    assert [queue.get(0.0) for _ in range(3)] == [3, 4, None]
    assert queue.dropped == {"superseded": 3}
    sized = BoundedQueue[bytes](10, size_of=len)
    sized.put(bytes(4))
    assert not sized.put(bytes(11))  # larger than the whole queue
    assert sized.dropped == Counter(superseded=1, full=1)
    sized = BoundedQueue[bytes](10, when_full="reject", size_of=len)
    assert [sized.put(bytes(size)) for size in (4, 4, 4, 2, 11)] == [True, True, False, True, False]
    assert sized.dropped == {"full": 2}
    assert [len(item) for item in sized.get_all(0.0)] == [4, 4, 2]
    assert sized.put(bytes(10))
    for when_full in ("wait", "drop_oldest", "reject"):
        queue = BoundedQueue[int](None, when_full=when_full)  # type: ignore[arg-type]
        assert all(queue.put(item) for item in range(3))
        assert [queue.get(0.0) for _ in range(3)] == [0, 1, 2]
    queue = BoundedQueue[int](None)
    assert all(queue.put(item) for item in range(4))
    queue.capacity = 2
    queue.put(4)
    assert queue.get_all(0.0) == [3, 4]


class Clock:
    """Stands for `time.monotonic`."""

    now = 0.0

    def monotonic(self) -> float:
        return self.now


def ages_of_a_receiver(monkeypatch, rate_hz: float, served_hz: Callable[[float], float], seconds: float):
    """Items at a rate, and a receiver that serves so many a second at a time: (N, 2) begin and age at the end; dropped; sent [s]."""
    clock, answered, dropped = Clock(), [], []
    monkeypatch.setattr(bounded_queue, "time", clock)
    queue = BoundedQueue[float](32, patience_s=0.25, on_drop=lambda item, _: dropped.append(item))
    sent, free_s = np.arange(0.0, seconds, 1.0 / rate_hz), 0.0
    for number, stamp in enumerate(sent):
        clock.now = stamp
        queue.put(stamp)
        until = sent[number + 1] if number + 1 < len(sent) else seconds + 100.0
        while (begin := max(free_s, clock.now)) < until:
            clock.now = begin
            if (item := queue.get(0.0)) is None:
                break
            free_s = begin + 1.0 / served_hz(begin)
            answered.append((begin, free_s - item))
    assert len(answered) + len(dropped) == len(sent)  # none is dropped uncounted
    return np.array(answered), len(dropped), len(sent)


def test_a_receiver_that_does_not_keep_up_gets_the_newest_items_at_any_rate(monkeypatch) -> None:
    for served in (10.0, 30.0, 60.0, 85.0, 89.0):
        for rate in (
            1.001 * served,
            1.02 * served,
            1.05 * served,
            1.1 * served,
            1.5 * served,
            3.0 * served,
            9.0 * served,
        ):
            found, dropped, sent = ages_of_a_receiver(monkeypatch, rate, lambda _, served=served: served, 60.0)
            periods = np.percentile(found[:, 1], 95) * served
            assert periods <= 2.5, (served, rate, periods)
            assert len(found) >= 0.97 * 60.0 * served, (served, rate, dropped, sent)  # it is never idle


def test_a_receiver_that_keeps_up_loses_nothing_and_nothing_in_a_pause(monkeypatch) -> None:
    for rate, served, pause in ((90.0, 94.0, 0.0), (90.0, 130.0, 0.1), (30.0, 60.0, 0.2), (30.0, 35.0, 0.06)):
        # Every 5 s it pauses, with one item in work.
        found, dropped, _ = ages_of_a_receiver(
            monkeypatch, rate, lambda at, s=served, p=pause: 1.0 / p if p and at % 5.0 < 1.0 / s else s, 60.0
        )
        assert dropped == 0, (rate, served, pause, dropped)
        assert np.percentile(found[:, 1], 50) < 2.0 / served


def test_a_receiver_that_was_late_loses_nothing_once_it_keeps_up(monkeypatch) -> None:
    found, dropped, sent = ages_of_a_receiver(monkeypatch, 90.0, lambda at: 45.0 if at < 5.0 else 130.0, 20.0)
    assert 200 < dropped < 235
    begins = found[:, 0]
    assert np.count_nonzero(begins > 6.0) == np.count_nonzero(np.arange(sent) / 90.0 > 6.0)


def test_a_full_queue_may_block_the_sender_until_it_is_read_or_closed() -> None:
    queue = BoundedQueue[int](1, when_full="wait")
    sender = threading.Thread(target=lambda: [queue.put(item) for item in range(22)], daemon=True)
    sender.start()
    got = []
    for _ in range(20):
        time.sleep(0.002)
        got.append(queue.get(1.0))
    assert (got, sum(queue.dropped.values())) == (list(range(20)), 0)
    time.sleep(0.05)
    assert sender.is_alive()
    queue.close("stopped")
    sender.join(1.0)
    assert not sender.is_alive()
    assert queue.get(0.0) is None
    assert queue.dropped == {"stopped": 2}
