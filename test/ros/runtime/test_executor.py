# SPDX-License-Identifier: Apache-2.0
"""Inputs are taken and worked on in one thread, and by another while that takes long; those of one stamp together."""

import threading
import time
from collections import Counter
from itertools import count

import pytest

from foretouch.ros.messages.conversions import header_to_msg
from foretouch.ros.runtime.processing_node import StampSynchronizer
from foretouch_msgs.msg import TablePlane

pytestmark = pytest.mark.ros


def slowed(monkeypatch, node, seconds, begun=None):
    """Note the threads that predict, and let each prediction take longer."""
    threads, original = [], node._predictor.array

    def predict(*args, **kwargs):
        threads.append(threading.current_thread().name)
        if begun is not None:
            begun.set()
        time.sleep(seconds)
        return original(*args, **kwargs)

    monkeypatch.setattr(node._predictor, "array", predict)
    return threads


def test_a_request_is_answered_in_the_thread_that_takes_it(graph, predictor, model_card, monkeypatch):
    node, send, heard = predictor(model=model_card)
    threads = slowed(monkeypatch, node, 0.0)
    for stamp in (1, 2, 3):
        send(stamp)
        graph.until(lambda stamp=stamp: len(heard) == stamp)
    assert threads == ["inputs"] * 3


def test_messages_are_taken_while_an_answer_takes_long(graph, predictor, model_card, monkeypatch):
    node, send, heard = predictor(model=model_card)
    tables = graph.talk_matched(TablePlane, "table")
    begun = threading.Event()
    slowed(monkeypatch, node, 1.0, begun)
    send(1)
    assert begun.wait(5.0)
    for stamp in (2, 3):
        tables.publish(TablePlane(header=header_to_msg("cam", stamp)))
        graph.until(lambda stamp=stamp: stamp in node._tables, timeout_s=0.8)
    assert not heard
    monkeypatch.undo()
    for stamp in (4, 5):  # of the queue, in order
        send(stamp)
    graph.until(lambda: len(heard) == 3)
    assert [one.header.stamp.nanosec for one in heard] == [1, 4, 5]
    summary = node.statistics.summary()
    assert (summary.received, summary.used, summary.lost) == (3, 3, 0)


def make(depth=3):
    drops, clock = Counter(), count()
    receive, drop = lambda: float(next(clock)), lambda reason: drops.update([reason])
    return StampSynchronizer(frozenset({"cloud", "table"}), depth, receive, drop), drops


def test_a_set_is_complete_in_either_order_and_the_oldest_incomplete_one_makes_room():
    sets, drops = make()
    assert sets.add("cloud", 7, "c7") is None
    assert sets.add("table", 8, "t8") is None
    assert sets.add("table", 7, "t7") == ({"cloud": "c7", "table": "t7"}, 0.0)
    assert sets.add("cloud", 8, "c8").arrived == 1.0
    assert (dict(drops), len(sets._waiting)) == ({}, 0)
    sets.add("cloud", 1_000_000_000_000_000_000, "c")
    assert sets.add("table", 1_000_000_000_000_000_001, "t") is None  # a nanosecond apart
    sets, drops = make(depth=3)
    for stamp in range(5):
        sets.add("cloud", stamp, stamp)
    assert drops == {"unpaired": 2}
    assert sets.add("table", 0, "late") is None
    assert sets.add("table", 4, "t").messages["cloud"] == 4
    waiting = len(sets._waiting)
    sets.clear("stopped")
    assert (drops["stopped"], len(sets._waiting)) == (waiting, 0)
    sets, drops = make()
    sets.add("cloud", 1, "first")
    sets.add("cloud", 1, "second")
    assert drops == {"repeated_stamp": 1}
    assert sets.add("table", 1, "t").messages["cloud"] == "second"
