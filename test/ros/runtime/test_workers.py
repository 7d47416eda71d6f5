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


def test_items_are_worked_on_in_order_in_another_thread_and_a_full_queue_drops_its_oldest():
    worker, begun, go = blocked(2)
    worker.put(0)
    assert begun.wait(5.0)
    for item in (1, 2, 3, 4):
        worker.put(item)
    assert worker.dropped == [(1, "superseded"), (2, "superseded")]
    go.set()
    until(lambda: len(worker.done) == 3)
    worker.stop()
    assert worker.done == [(item, "w") for item in (0, 3, 4)]


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


def chained(*steps):
    """Workers of the same thread, of which each puts its items into the next."""
    thread, workers = WorkerThread("shared"), []
    for number, step in enumerate(steps):

        def then(item, number=number, step=step):
            step(item)
            if number + 1 < len(workers):
                workers[number + 1].put(item)

        workers.append(Recorded(str(number), then=then, thread=thread))
    for worker in workers:
        worker.start()
    return workers


def test_no_item_is_begun_while_another_waits_for_its_next_step():
    order = []
    one, last = workers = chained(lambda item: order.append(("first", item)), lambda item: order.append(("last", item)))
    with one._thread._changed:  # so that all wait
        for item in (1, 2, 3):
            one._queue.put(item)
            one._thread._calls.append(one)
    one.put(4)
    until(lambda: len(order) == 8)
    for worker in workers:
        worker.stop()
    assert order == [(step, item) for item in (1, 2, 3, 4) for step in ("first", "last")]
    assert last.items == [1, 2, 3, 4]
