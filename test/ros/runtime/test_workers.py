# SPDX-License-Identifier: Apache-2.0
"""Of what waits, the newest comes next; what is dropped is reported, also when a worker is stopped."""

import threading
import time

from foretouch.ros.runtime.workers import Worker


class Recorded:
    """A worker whose work waits for `go`."""

    def __init__(self, **options):
        self.done, self.dropped, self.begun, self.go = [], [], threading.Semaphore(0), threading.Semaphore(0)
        self.errors = []
        self.worker = Worker("w", self.work, self.errors.append, lambda *one: self.dropped.append(one), **options)

    def work(self, item):
        self.begun.release()
        assert self.go.acquire(timeout=5.0)
        self.done.append(item)

    def begin(self, item):
        self.worker.put(item)
        assert self.begun.acquire(timeout=5.0)


def test_the_newest_replaces_the_oldest_that_waits():
    for depth, done, dropped in ((1, [1, 4], [2, 3]), (2, [1, 3, 4], [2])):
        one = Recorded(depth=depth)
        one.worker.start()
        one.begin(1)
        for item in (2, 3, 4):
            one.worker.put(item)
        for _ in done:
            one.go.release()
        for _ in done[1:]:
            assert one.begun.acquire(timeout=5.0)
        one.worker.stop()
        assert (one.done, one.dropped) == (done, [(item, "superseded") for item in dropped])


def test_stopping_drops_what_waits_and_what_comes_later_and_a_worker_can_be_started_again():
    one = Recorded()
    one.worker.stop()  # never started
    one.worker.start()
    one.begin("a")
    one.worker.put("b")
    stopper = threading.Thread(target=one.worker.stop)
    stopper.start()
    while not one.dropped:
        time.sleep(0.001)
    one.go.release()
    stopper.join(5.0)
    one.worker.put("late")
    assert (one.done, one.dropped) == (["a"], [("b", "stopped"), ("late", "stopped")])
    one.worker.start()
    one.go.release()
    one.begin("c")
    one.worker.stop()
    assert one.done == ["a", "c"]


def test_work_that_takes_too_long_is_left_behind_and_knows_it():
    one = Recorded()
    behind = []
    work = one.work
    one.worker = Worker(
        "w",
        lambda item: (work(item), behind.append((item, one.worker.left_behind))),
        one.errors.append,
        lambda *_: None,
    )
    one.worker.start()
    one.begin("slow")
    assert one.worker.busy_s > 0.0
    assert not one.worker.stop(0.01)
    one.worker.start()
    one.begin("next")
    one.go.release()
    one.go.release()
    while len(behind) < 2:
        time.sleep(0.001)
    assert sorted(behind) == [("next", False), ("slow", True)]
    one.go.release()
    one.begin("after")  # which the thread that was left behind does not take
    assert one.worker.stop(5.0)
    assert behind[-1] == ("after", False)
    assert (one.worker.busy_s, one.errors) == (0.0, [])
