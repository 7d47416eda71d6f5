# SPDX-License-Identifier: Apache-2.0
"""The queue between threads: what is kept, what is dropped, and who waits."""

import threading
import time
from collections import Counter

from foretouch.base.bounded_queue import BoundedQueue


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
