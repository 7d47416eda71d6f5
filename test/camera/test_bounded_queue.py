# SPDX-License-Identifier: Apache-2.0
"""The queue between threads: what is kept, what is dropped, and who waits."""

import threading
import time
from collections import Counter

from foretouch.camera.bounded_queue import BoundedQueue


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


def test_a_patient_queue_drops_nothing_in_a_pause_and_keeps_to_its_capacity_after_it() -> None:
    queue = BoundedQueue[int](2, patience_s=0.2)
    assert all(queue.put(item) for item in range(8))
    assert not queue.dropped
    queue.put(8)  # beyond four times the capacity
    assert queue.dropped == {"superseded": 1}
    time.sleep(0.25)
    queue.put(9)
    assert queue.get_all(0.0) == [8, 9]


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


def test_what_waits_can_be_taken_out_of_a_closed_queue_for_which_a_receiver_waits_no_longer_than_asked() -> None:
    queue = BoundedQueue[int](3)
    queue.put(0)
    queue.put(1)
    queue.close()
    assert not queue.put(2)
    assert queue.closed
    assert (queue.get(), queue.get_all(), queue.get()) == (0, [1], None)
    assert queue.dropped == {"closed": 1}
    queue.reopen()
    assert queue.put(3)
    assert queue.get() == 3
    got: list[int | None] = []
    receiver = threading.Thread(target=lambda: got.append(queue.get()), daemon=True)
    receiver.start()
    queue.close()
    receiver.join(1.0)
    assert got == [None]
    started = time.monotonic()
    assert BoundedQueue[int](1).get(0.1) is None
    assert 0.09 < time.monotonic() - started < 0.5
