# SPDX-License-Identifier: Apache-2.0
"""Messages that reach no callback are counted, whoever lost them."""

import threading
import time

import pytest
from diagnostic_msgs.msg import DiagnosticArray

from foretouch.ros.runtime.direct import SUPPORTED
from foretouch.ros.runtime.losses import Losses
from foretouch_msgs.msg import TablePlane

pytestmark = pytest.mark.ros


def info(sequence: int, publisher: bytes = b"a") -> dict:
    return {"publication_sequence_number": sequence, "publisher_gid": {"data": publisher}}


def test_gaps_and_reports_of_the_same_loss_are_counted_once() -> None:
    told: list[int] = []
    losses = Losses(told.append)
    for sequence in (7, 8, 12):
        losses.arrived(info(sequence))
    losses.arrived(info(100, b"b"))  # another publisher, heard for the first time
    losses.arrived(info(12))  # again
    losses.arrived({})  # a middleware without numbers
    losses.reported(2)
    assert (losses.count, told) == (3, [3])
    losses.reported(2)
    assert (losses.count, told) == (4, [3, 1])


@pytest.mark.skipif(not SUPPORTED, reason="rclpy does not pass the publisher of a message before Kilted")
def test_a_message_that_is_replaced_in_the_queue_is_counted(graph) -> None:
    (node,) = graph.add("grasp", diagnostics_period_s=0.1)
    heard = graph.listen(DiagnosticArray, "/diagnostics")
    tables = graph.talk(TablePlane, "table")
    graph.matched("table")
    tables.publish(TablePlane())
    graph.until(lambda: node.statistics.summary().received)
    blocked, released = threading.Event(), threading.Event()
    graph.probe.create_timer(0.01, lambda: (blocked.set(), released.wait()))  # the executor does not get to run
    blocked.wait()
    for number in range(20):
        message = TablePlane()
        message.header.stamp.nanosec = number
        tables.publish(message)
    time.sleep(0.2)
    released.set()
    graph.until(lambda: node.statistics.summary().lost == 15)
    graph.until(lambda: heard and _values(heard[-1]).get("lost_on_the_way.table") == "15")


def _values(report: DiagnosticArray) -> dict[str, str]:
    return {pair.key: pair.value for pair in report.status[0].values}
