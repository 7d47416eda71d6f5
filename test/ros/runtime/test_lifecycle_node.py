# SPDX-License-Identifier: Apache-2.0
"""Lifecycle, QoS and diagnostics of a live node."""

import pytest
from lifecycle_msgs.msg import State
from lifecycle_msgs.srv import GetState
from sensor_msgs.msg import PointCloud2

from foretouch.ros.messages.clouds import cloud_to_msg
from foretouch_msgs.msg import TablePlane

pytestmark = pytest.mark.ros


def state(graph):
    return graph.call(GetState, "segmentation/get_state").current_state.id


def test_without_autostart_it_waits_and_walks_through_its_states(graph, scene_cloud):
    (node,) = graph.add("segmentation", autostart=False)
    assert state(graph) == State.PRIMARY_STATE_UNCONFIGURED
    assert graph.change("segmentation", "configure")
    assert state(graph) == State.PRIMARY_STATE_INACTIVE
    heard, publisher = graph.listen(TablePlane, "table"), graph.talk(PointCloud2, "points")
    graph.matched("points", "table")
    publisher.publish(cloud_to_msg(scene_cloud(stamp_ns=1)))
    graph.until(lambda: node.statistics.summary().dropped == {"inactive": 1})
    assert graph.change("segmentation", "activate")
    publisher.publish(cloud_to_msg(scene_cloud(stamp_ns=2)))
    graph.until(lambda: heard)
    assert [message.header.stamp.nanosec for message in heard] == [2]
    assert not graph.change("segmentation", "configure")  # from this state there is no such transition
    assert graph.change("segmentation", "deactivate", "cleanup")
    assert state(graph) == State.PRIMARY_STATE_UNCONFIGURED
    assert graph.probe.count_publishers("/foretouch/table") == 0
    assert graph.change("segmentation", "configure", "activate")
    graph.matched("points", "table")
    publisher.publish(cloud_to_msg(scene_cloud(stamp_ns=3)))
    graph.until(lambda: len(heard) == 2)
    graph.until(lambda: node.statistics.summary().used == 2)  # counted just after it was published


def test_a_best_effort_camera_is_heard_and_diagnostics_hold_counts_ages_and_latencies(graph, scene_cloud):
    graph.add("segmentation", diagnostics_period_s=0.1)
    reports, publisher = graph.reports("segmentation"), graph.talk_matched(PointCloud2, "points", reliable=False)
    publisher.publish(cloud_to_msg(scene_cloud(stamp_ns=graph.probe.get_clock().now().nanoseconds)))
    graph.until(lambda: reports and reports[-1].values.get("used") == "1")
    known = reports[-1].values
    assert (known["received"], known["dropped"], known["answered.ok"]) == ("1", "0", "1")
    assert 0.0 < float(known["latency_ms.p50"]) <= float(known["latency_ms.p95"])
    assert float(known["input_age_ms.p50"]) > 0.0


def test_an_invalid_transition_is_no_internal_error_and_a_failing_start_ends_what_it_started(graph, monkeypatch):
    (node,) = graph.add("segmentation", autostart=False)
    assert not graph.change("segmentation", "activate")
    assert (node.state_name, node.internal_errors.counts()) == ("unconfigured", {})
    assert graph.change("segmentation", "configure")
    stopped = []

    def fail():
        raise OSError("no thread")

    monkeypatch.setattr(node, "_start", fail)
    monkeypatch.setattr(node, "_stop", lambda: stopped.append(True))
    assert not graph.change("segmentation", "activate")
    assert (stopped, node.state_name, node.failure) == ([True], "inactive", "OSError: no thread")
