# SPDX-License-Identifier: Apache-2.0
import threading
import time

from foretouch.ros.runtime.workers import Worker, WorkerThread, helping


class Recorded(Worker):
    """A worker that lists its items with the threads that worked on them, and what it dropped."""

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


def test_stopping_drops_what_waits_and_comes_later_of_one_worker_of_a_thread_alone():
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
    one.start()
    other.start()
    one.stop()
    other.put(1)
    until(lambda: other.items == [1])
    other.stop()
    assert "shared" not in [running.name for running in threading.enumerate()]


def chained(thread, begun=None):
    """Two workers of a thread, of which one puts its items into the other."""
    last = Recorded("last", thread=thread)
    one = Recorded("first", then=lambda item: (begun and begun.wait(5.0), last.put(item)), thread=thread)
    for worker in (one, last):
        worker.start()
    return one, last


def test_what_one_worker_hands_to_another_of_its_thread_comes_before_all_that_waits():
    begun, order = threading.Event(), []
    one, last = chained(WorkerThread("shared"), begun)
    one.done = last.done = order
    for item in (1, 2, 3):
        one.put(item)
    begun.set()  # all are put
    until(lambda: len(order) == 6)
    one.stop()
    last.stop()
    assert order == [(item, "shared") for item in (1, 1, 2, 2, 3, 3)]


def test_a_helper_works_on_an_item_and_on_all_that_follows_from_it_and_the_thread_on_the_rest():
    thread, own = WorkerThread("shared"), threading.current_thread().name
    one, last = chained(thread)
    until(lambda: thread._changed._waiters)  # before it waits, the thread would take what comes without being called
    with helping() as found:
        one.put(1)
        one.put(2)
    assert (found, one.done) == ([thread], [])
    assert thread.work()  # there is more
    assert one.done == last.done == [(1, own)]
    assert not thread.work()
    assert one.done == last.done == [(1, own), (2, own)]
    assert not thread.work()
    with helping():
        one.put(3)
    thread.wake()
    until(lambda: last.done[2:] == [(3, "shared")])
    for worker in (one, last):
        worker.stop()


def test_a_helper_and_the_thread_never_work_at_the_same_time():
    thread, active, most = WorkerThread("shared"), [], []

    def work(item):
        active.append(item)
        most.append(len(active))
        time.sleep(0.002)
        active.remove(item)

    worker = Recorded(depth=1000, then=work, thread=thread)
    worker.start()
    others = threading.Thread(target=lambda: [worker.put(k) for k in range(50)])
    others.start()
    for k in range(50, 80):
        with helping() as found:
            worker.put(k)
        while found and found[0].work():
            pass
    others.join(5.0)
    until(lambda: len(most) == 80 and not active)
    worker.stop()
    assert sorted(worker.items) == list(range(80))
    assert max(most) == 1
