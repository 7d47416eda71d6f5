# SPDX-License-Identifier: Apache-2.0
import threading
import time

from foretouch.ros.runtime.workers import Worker, WorkerThread


class Recorded(Worker):
    """A worker that lists its items with the thread that worked on them, and what it dropped."""

    def __init__(self, name="w", depth=10, then=None, thread=None):
        self.done, self.dropped, self._then = [], [], then or (lambda _: None)
        super().__init__(name, depth, self._note, lambda item, reason: self.dropped.append((item, reason)), thread)

    def _note(self, item):
        self.done.append((item, threading.current_thread().name))
        self._then(item)

    @property
    def items(self):
        return [item for item, _ in self.done]


def until(condition):
    end = time.monotonic() + 5.0
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.001)


def blocked(depth):
    """A worker that waits in each item, with the events of its begin and of going on."""
    begun, go = threading.Event(), threading.Event()
    worker = Recorded(depth=depth, then=lambda _: (begun.set(), go.wait(5.0)))
    worker.start()
    return worker, begun, go


def test_stopping_drops_what_waits_and_comes_later_of_one_worker_alone():
    Recorded().stop()  # never started
    worker, begun, go = blocked(5)
    worker.put("a")
    assert begun.wait(5.0)
    worker.put("b")
    stopper = threading.Thread(target=worker.stop)
    stopper.start()
    until(lambda: worker._queue.closed)
    go.set()
    stopper.join(5.0)
    worker.put("late")
    assert (worker.items, worker.dropped) == (["a"], [("b", "stopped"), ("late", "stopped")])
    worker.start()
    worker.put("c")
    until(lambda: worker.items == ["a", "c"])
    worker.stop()
    thread = WorkerThread("shared")
    one, other = Recorded(thread=thread), Recorded(thread=thread)
    one.stop()
    other.put(1)
    until(lambda: other.items == [1])
    other.stop()
