# SPDX-License-Identifier: Apache-2.0
"""Messages that reach no callback are counted, whoever lost them."""

import threading
import time

import pytest

from foretouch.ros.runtime.diagnostics import Losses
from foretouch.ros.runtime.direct import SUPPORTED
from foretouch_msgs.msg import TablePlane

pytestmark = pytest.mark.ros


def test_gaps_and_events_of_the_same_loss_are_counted_once():
    lost = []
    losses = Losses(lost.append)
    for sequence, publisher in ((7, b"a"), (8, b"a"), (12, b"a"), (100, b"b"), (12, b"a")):
        losses.arrived({"publication_sequence_number": sequence, "publisher_gid": {"data": publisher}})
    losses.arrived({})  # a middleware without numbers
    losses.reported(2)
    assert (losses.count, lost) == (3, [3])
    losses.reported(2)
    assert (losses.count, lost) == (4, [3, 1])


@pytest.mark.skipif(not SUPPORTED, reason="rclpy does not pass the publisher of a message before Kilted")
def test_a_message_that_is_replaced_in_the_queue_is_counted(graph):
    (node,) = graph.add("grasp", diagnostics_period_s=0.1)
    reports, tables = graph.reports("grasp"), graph.talk(TablePlane, "table")
    graph.matched("table")
    tables.publish(TablePlane())
    graph.until(lambda: node.statistics.summary().received)
    blocked, released = threading.Event(), threading.Event()
    node.subscribe(TablePlane, "other", lambda _: (blocked.set(), released.wait()))  # it takes all inputs of the node
    other = graph.talk(TablePlane, "other")
    graph.matched("other")
    other.publish(TablePlane())
    assert blocked.wait(5.0)
    for number in range(20):
        message = TablePlane()
        message.header.stamp.nanosec = number
        tables.publish(message)
    time.sleep(0.2)
    released.set()
    graph.until(lambda: node.statistics.summary().lost == 15)
    graph.until(lambda: reports and reports[-1].values.get("lost_on_the_way.table") == "15")
