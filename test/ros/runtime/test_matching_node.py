# SPDX-License-Identifier: Apache-2.0
"""Inputs are taken in one thread and worked on in another; those of one stamp together."""

import io
import threading
import time
from itertools import count

import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from rich.console import Console
from sensor_msgs.msg import PointCloud2

from foretouch.cli.live import live_panel
from foretouch.ros.messages.conversions import header_to_msg
from foretouch.ros.nodes.monitor import MonitorNode
from foretouch_msgs.msg import Status, TablePlane

pytestmark = pytest.mark.ros


def test_messages_are_taken_while_an_answer_takes_long(graph, predictor, model_card, monkeypatch):
    node, send, heard = predictor(model=model_card)
    tables = graph.talk_matched(TablePlane, "table")
    begun, predict = threading.Event(), node._step.predictor.answer

    def slowly(*args, **kwargs):
        begun.set()
        time.sleep(1.0)
        return predict(*args, **kwargs)

    monkeypatch.setattr(node._step.predictor, "answer", slowly)
    send(1)
    assert begun.wait(5.0)
    for stamp in (2, 3):
        tables.publish(TablePlane(header=header_to_msg("cam", stamp)))
        graph.until(lambda stamp=stamp: stamp in node._tables, timeout_s=0.8)
    assert not heard
    monkeypatch.undo()
    for stamp in (4, 5):
        send(stamp)
    graph.until(lambda: len(heard) == 2)
    assert [one.header.stamp.nanosec for one in heard] == [1, 5]
    graph.until(lambda: node.statistics.summary().used == 2)
    summary = node.statistics.summary()
    assert (summary.received, dict(summary.dropped), summary.lost) == (3, {"superseded": 1}, 0)


def test_clouds_without_grasps_are_answered_counted_and_reported_first_as_a_warning_then_as_an_error(predictor, graph):
    node, send, heard = predictor(model="simulated", partner_timeout_s=0.5, silence_s=1.5, diagnostics_period_s=0.2)
    reports, clouds = graph.reports("touch_predictor"), graph.talk_matched(PointCloud2, "object_cloud")
    stamps, monitor = count(1), MonitorNode()
    graph.serve(monitor)
    send(next(stamps))
    graph.until(lambda: heard and heard[0].status == Status.OK)

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
    last = next(stamps)
    assert last < 80  # clouds, one each 0.05 s or later
    send(last)
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
