# SPDX-License-Identifier: Apache-2.0
"""Subscriptions follow what publishers offer, and count what reaches no callback, whoever lost it."""

import threading
import time
from types import SimpleNamespace

import pytest
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from foretouch.errors import ConfigError
from foretouch.ros.nodes import NODES
from foretouch.ros.runtime.subscription import InputTopic, Losses
from foretouch_msgs.msg import TablePlane

pytestmark = pytest.mark.ros


def test_gaps_in_the_numbers_of_each_publisher_are_losses_and_a_new_numbering_is_none():
    lost = []
    losses = Losses(lost.append)
    for number, publisher in ((7, b"a"), (8, b"a"), (12, b"a"), (100, b"b"), (13, b"a"), (1, b"a"), (3, b"a")):
        losses.arrived({"publication_sequence_number": number, "publisher_gid": {"data": publisher}}, 2)
    losses.reported(SimpleNamespace(total_count_change=9))  # they show in the numbers
    assert (losses.count, lost) == (4, [3, 1])


def test_losses_that_no_number_shows_are_those_that_the_middleware_reports():
    losses = Losses()
    for number, publishers in ((1, 1), (3, 1), (9, 2), (4, 2), (5, 1), (6, 1)):  # of two publishers without a name
        losses.arrived({"publication_sequence_number": number}, publishers)
        losses.reported(SimpleNamespace(total_count_change=10))
    assert losses.count == 1 + 10 + 10
    losses.arrived({"publication_sequence_number": None}, 1)
    losses.reported(SimpleNamespace(total_count_change=5))
    assert losses.count == 26


def test_a_message_that_is_replaced_in_the_queue_is_counted(graph):
    (node,) = graph.add("grasp", diagnostics_period_s=0.1)
    reports, tables = graph.reports("grasp"), graph.talk_matched(TablePlane, "table")
    tables.publish(TablePlane())
    graph.until(lambda: node.statistics.summary().received)
    blocked, released = threading.Event(), threading.Event()
    node.subscribe(
        InputTopic("other", TablePlane), lambda _: (blocked.set(), released.wait())
    )  # it takes all inputs of the node
    other = graph.talk_matched(TablePlane, "other")
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


def table(stamp):
    message = TablePlane()
    message.header.stamp.nanosec = stamp
    return message


class Receiver:
    """A node with one input, and the stamps that it received."""

    def __init__(self, graph, latched=None, **overrides):
        names = {name: f"qos_overrides./foretouch/other.subscription.{name}" for name in overrides}
        parameters = [Parameter(names[name], value=value) for name, value in overrides.items()]
        self.node = NODES.load("grasp")(parameter_overrides=parameters)
        graph.serve(self.node)
        self.stamps = []
        hear = lambda message: self.stamps.append(message.header.stamp.nanosec)  # noqa: E731
        self.node.subscribe(InputTopic("other", TablePlane, latched=latched), hear)

    @property
    def qos(self):
        (found,) = [
            subscription for subscription in self.node.subscriptions if subscription.topic_name == "/foretouch/other"
        ]
        return found.qos_profile.reliability.name, found.qos_profile.durability.name


def talk(graph, *, reliable, latched):
    profile = QoSProfile(
        depth=10,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )
    return graph.probe.create_publisher(TablePlane, "other", profile)


def test_it_is_reliable_and_latched_where_all_publishers_are_and_receives_from_all_others_too(graph):
    early = talk(graph, reliable=True, latched=True)
    early.publish(table(1))  # before anybody subscribes
    receiver = Receiver(graph)
    graph.until(lambda: receiver.stamps == [1])
    assert receiver.qos == ("RELIABLE", "TRANSIENT_LOCAL")
    other = talk(graph, reliable=False, latched=False)
    graph.until(lambda: receiver.qos == ("BEST_EFFORT", "VOLATILE"))
    graph.until(lambda: other.get_subscription_count() == early.get_subscription_count() == 1)
    for stamp in (2, 3):
        (early if stamp == 2 else other).publish(table(stamp))
        graph.until(lambda stamp=stamp: receiver.stamps[-1] == stamp)
    graph.probe.destroy_publisher(other)
    graph.until(lambda: receiver.qos == ("RELIABLE", "TRANSIENT_LOCAL"))
    graph.until(lambda: early.get_subscription_count() == 1)
    early.publish(table(4))
    graph.until(lambda: receiver.stamps[-1] == 4)
    assert sorted(receiver.stamps) == [1, 2, 3, 4]  # those that are sent again are not received again


def test_an_override_is_kept_whatever_publishers_offer_and_one_that_names_no_policy_is_refused(graph):
    talk(graph, reliable=True, latched=True).publish(table(1))
    receiver = Receiver(graph, reliability="best_effort", durability="volatile")
    late = Receiver(graph, latched=False, durability="transient_local")
    graph.until(lambda: late.stamps == [1])
    graph.until(lambda: receiver.node.get_publishers_info_by_topic("/foretouch/other"))
    time.sleep(1.2)  # it has looked twice
    assert receiver.qos == ("BEST_EFFORT", "VOLATILE")
    assert receiver.stamps == []
    with pytest.raises(ConfigError, match=r"other.subscription.durability: 'eternal' is not one of system_default"):
        Receiver(graph, durability="eternal")
