# SPDX-License-Identifier: Apache-2.0
"""Inputs are taken in one thread and worked on in others; those of one stamp together."""

import io
import threading
import time
from collections import Counter
from itertools import count

import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from rich.console import Console
from sensor_msgs.msg import PointCloud2

from foretouch.cli.live import live_panel
from foretouch.ros.messages.conversions import header_to_msg
from foretouch.ros.nodes.monitor import MonitorNode
from foretouch.ros.runtime.processing_node import StampSynchronizer
from foretouch_msgs.msg import Status, TablePlane

pytestmark = pytest.mark.ros


def test_messages_are_taken_while_an_answer_takes_long(graph, predictor, model_card, monkeypatch):
    node, send, heard = predictor(model=model_card)
    tables = graph.talk_matched(TablePlane, "table")
    begun, predict = threading.Event(), node._predictor.answer

    def slowly(*args, **kwargs):
        begun.set()
        time.sleep(1.0)
        return predict(*args, **kwargs)

    monkeypatch.setattr(node._predictor, "answer", slowly)
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
    given_up = [sets.add("cloud", stamp, stamp) for stamp in range(5)]
    assert given_up == [None, None, None, ({"cloud": 0}, 0.0), ({"cloud": 1}, 1.0)]
    assert sets.add("table", 0, "late") is None
    assert sets.add("table", 4, "t").messages["cloud"] == 4
    assert sets.overdue(2.5) == [({"cloud": 2}, 2.0)]
    assert (sets.add("cloud", 2, "again"), sets.add("table", 2, "t")) == (None, ({"cloud": "again", "table": "t"}, 5.0))
    waiting = len(sets._waiting)
    assert (waiting, dict(drops)) == (1, {})
    sets.clear("stopped")
    assert (drops["stopped"], len(sets._waiting)) == (waiting, 0)
    sets, drops = make()
    sets.add("cloud", 1, "first")
    sets.add("cloud", 1, "second")
    assert drops == {"repeated_stamp": 1}
    assert sets.add("table", 1, "t").messages["cloud"] == "second"


def test_clouds_without_grasps_are_answered_counted_and_reported_first_as_a_warning_then_as_an_error(predictor, graph):
    node, send, heard = predictor(model="touchnet-v1", partner_timeout_s=0.5, silence_s=1.5, diagnostics_period_s=0.2)
    reports, clouds = graph.reports("touch_predictor"), graph.talk_matched(PointCloud2, "object_cloud")
    stamps, monitor = count(1), MonitorNode()
    graph.serve(monitor)
    send(next(stamps))
    graph.until(lambda: heard and heard[0].status == Status.OK)
    began = time.monotonic()

    def lacking():
        message = PointCloud2(header=header_to_msg("cam", next(stamps)))
        clouds.publish(message)
        time.sleep(0.05)

    for level, text in ((DiagnosticStatus.WARN, "no_grasps"), (DiagnosticStatus.ERROR, "clouds without grasps")):
        graph.until(
            lambda level=level, text=text: (
                lacking() or (reports and reports[-1].level == level and text in reports[-1].message)
            )
        )
    assert "without grasps (published by /foretouch/probe)" in reports[-1].message
    console = Console(file=io.StringIO(), width=200)
    graph.until(
        lambda: console.print(live_panel(monitor.view(), "")) or "without grasps (published" in console.file.getvalue()
    )
    assert time.monotonic() - began < 4.0
    send(next(stamps))
    graph.until(lambda: heard[-1].status == Status.OK)
    last = next(stamps) - 1
    graph.until(lambda: len(heard) == last)
    assert sorted(one.header.stamp.nanosec for one in heard) == list(range(1, last + 1))  # each is answered once
    failed = [one.reason for one in heard if one.status == Status.FAILED]
    summary = node.statistics.summary()
    assert (summary.received, summary.used, dict(summary.dropped)) == (last, 2, {"no_grasps": last - 2})
    assert len(failed) == last - 2
    assert all(reason.startswith("no_grasps: ") for reason in failed)
    graph.until(lambda: reports[-1].level == DiagnosticStatus.OK)
