# SPDX-License-Identifier: Apache-2.0
"""What waits when a worker is stopped is dropped and told; full queues are those of `test/camera/test_bounded_queue.py`."""

import threading
import time

from foretouch.ros.runtime.workers import Worker


def test_stopping_drops_what_waits_and_what_comes_later_and_a_worker_can_be_started_again():
    done, dropped, begun, go = [], [], threading.Event(), threading.Event()

    def work(item):
        done.append(item)
        begun.set()
        go.wait(5.0)

    worker = Worker("w", 5, work, lambda *one: dropped.append(one), None)
    worker.stop()  # never started
    worker.start()
    worker.put("a")
    assert begun.wait(5.0)
    worker.put("b")
    stopper = threading.Thread(target=worker.stop)
    stopper.start()
    while not worker._queue.closed:
        time.sleep(0.001)
    go.set()
    stopper.join(5.0)
    worker.put("late")
    assert (done, dropped) == (["a"], [("b", "stopped"), ("late", "stopped")])
    begun.clear()
    worker.start()
    worker.put("c")
    assert begun.wait(5.0)
    worker.stop()
    assert done == ["a", "c"]
