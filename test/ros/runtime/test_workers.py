# SPDX-License-Identifier: Apache-2.0
import threading
import time

from foretouch.ros.runtime.workers import Worker, WorkerThread, helping


def test_items_are_worked_on_in_order_in_another_thread():
    done, threads, ready = [], set(), threading.Event()

    def work(item):
        done.append(item)
        threads.add(threading.current_thread().name)
        if item == 9:
            ready.set()

    worker = Worker("smith", 100, work, lambda *_: None)
    worker.start()
    for item in range(10):
        worker.put(item)
    assert ready.wait(5.0)
    worker.stop()
    assert done == list(range(10))
    assert threads == {"smith"}


def test_a_full_queue_gives_up_its_oldest_and_says_so():
    begun, go = threading.Event(), threading.Event()
    done, dropped = [], []

    def work(item):
        done.append(item)
        begun.set()
        go.wait(5.0)

    worker = Worker("slow", 2, work, lambda item, reason: dropped.append((item, reason)))
    worker.start()
    worker.put(0)
    assert begun.wait(5.0)
    for item in (1, 2, 3, 4):
        worker.put(item)
    assert dropped == [(1, "superseded"), (2, "superseded")]
    go.set()
    worker.stop()
    assert set(done) | {item for item, _ in dropped} == {0, 1, 2, 3, 4}


def test_stopping_gives_up_what_waits_and_starting_again_works():
    begun, go = threading.Event(), threading.Event()
    done, dropped = [], []

    def work(item):
        done.append(item)
        begun.set()
        go.wait(5.0)

    worker = Worker("w", 5, work, lambda item, reason: dropped.append((item, reason)))
    worker.start()
    worker.put("a")
    assert begun.wait(5.0)
    worker.put("b")
    stopper = threading.Thread(target=worker.stop)
    stopper.start()
    while not worker._queue.closed:
        pass
    go.set()
    stopper.join(5.0)
    assert done == ["a"]
    assert dropped == [("b", "stopped")]
    begun.clear()
    worker.start()
    worker.put("c")
    assert begun.wait(5.0)
    worker.stop()
    assert done == ["a", "c"]


def test_stopping_what_never_started_is_harmless():
    Worker("idle", 1, print, print).stop()


def test_what_comes_after_the_end_is_counted_as_stopped():
    dropped = []
    worker = Worker("w", 2, print, lambda item, reason: dropped.append((item, reason)))
    worker.start()
    worker.stop()
    worker.put("late")
    assert dropped == [("late", "stopped")]


def test_what_one_worker_hands_to_another_of_its_thread_comes_before_all_that_waits():
    done, ready, begun = [], threading.Event(), threading.Event()
    thread = WorkerThread("shared")

    def first(item):
        begun.wait(5.0)  # until all are put
        done.append(("first", item))
        second.put(item)

    def last(item):
        done.append(("second", item, threading.current_thread().name))
        if item == 3:
            ready.set()

    one = Worker("first", 10, first, lambda *_: None, thread)
    second = Worker("second", 10, last, lambda *_: None, thread)
    for worker in (one, second):
        worker.start()
    for item in (1, 2, 3):
        one.put(item)
    begun.set()
    assert ready.wait(5.0)
    one.stop()
    second.stop()
    assert done == [step for item in (1, 2, 3) for step in (("first", item), ("second", item, "shared"))]


def test_stopping_one_worker_of_a_thread_leaves_the_other_working():
    done, thread = threading.Event(), WorkerThread("shared")
    one, other = (Worker("w", 5, lambda _: done.set(), lambda *_: None, thread) for _ in range(2))
    one.start()
    other.start()
    one.stop()
    other.put(1)
    assert done.wait(5.0)
    other.stop()
    assert "shared" not in [running.name for running in threading.enumerate()]


def names_of(thread):
    """Two workers of a thread, of which one puts its items into the other, and who did what."""
    done = []

    def first(item):
        done.append(("first", item, threading.current_thread().name))
        last.put(item)

    one = Worker("first", 10, first, lambda *_: None, thread)
    last = Worker("last", 10, lambda item: done.append(("last", item, threading.current_thread().name)), print, thread)
    for worker in (one, last):
        worker.start()
    while not thread._changed._waiters:  # before it waits, the thread would take what comes without being called
        time.sleep(0.001)
    return one, last, done


def test_a_helper_works_on_an_item_and_on_all_that_follows_from_it():
    thread, own = WorkerThread("shared"), threading.current_thread().name
    one, last, done = names_of(thread)
    with helping() as found:
        one.put(1)
        one.put(2)
    assert found == [thread]
    assert not done
    assert thread.work()  # there is more
    assert done == [("first", 1, own), ("last", 1, own)]
    assert not thread.work()
    assert done[2:] == [("first", 2, own), ("last", 2, own)]
    assert not thread.work()
    for worker in (one, last):
        worker.stop()


def test_what_a_helper_leaves_is_done_by_the_thread():
    thread = WorkerThread("shared")
    one, last, done = names_of(thread)
    with helping():
        one.put(1)
    thread.wake()
    end = time.monotonic() + 5.0
    while len(done) < 2 and time.monotonic() < end:
        time.sleep(0.01)
    assert done == [("first", 1, "shared"), ("last", 1, "shared")]
    for worker in (one, last):
        worker.stop()


def test_a_helper_and_the_thread_never_work_at_the_same_time():
    thread, active, most, done = WorkerThread("shared"), [], [], []

    def work(item):
        active.append(item)
        most.append(len(active))
        time.sleep(0.002)
        active.remove(item)
        done.append(item)

    worker = Worker("w", 1000, work, lambda *_: None, thread)
    worker.start()
    others = threading.Thread(target=lambda: [worker.put(k) for k in range(50)])
    others.start()
    for k in range(50, 80):
        with helping() as found:
            worker.put(k)
        while found and found[0].work():
            pass
    others.join(5.0)
    end = time.monotonic() + 5.0
    while len(done) < 80 and time.monotonic() < end:
        time.sleep(0.01)
    worker.stop()
    assert sorted(done) == list(range(80))
    assert max(most) == 1
