# SPDX-License-Identifier: Apache-2.0
"""Lifecycle, QoS and diagnostics of a live node."""

import gc

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rcl_interfaces.msg import Parameter as ParameterMsg
from rcl_interfaces.msg import ParameterType, ParameterValue
from rcl_interfaces.srv import DescribeParameters, SetParameters
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import PointCloud2

from foretouch.errors import ConfigError
from foretouch.ros.executables import make_nodes
from foretouch.ros.messages.clouds import cloud_to_msg
from foretouch_msgs.msg import ObjectArray, TablePlane

pytestmark = pytest.mark.ros


def change(graph, transition):
    request = ChangeState.Request(transition=Transition(id=transition))
    return graph.call(ChangeState, "segmentation/change_state", request).success


def state(graph):
    return graph.call(GetState, "segmentation/get_state", GetState.Request()).current_state.id


def test_a_node_starts_by_itself_in_its_namespace(graph):
    (node,) = graph.add("segmentation")
    assert node.get_fully_qualified_name() == "/foretouch/segmentation"
    assert state(graph) == State.PRIMARY_STATE_ACTIVE


def test_without_autostart_it_waits_and_walks_through_its_states(graph, scene_cloud):
    (node,) = graph.add("segmentation", autostart=False)
    assert state(graph) == State.PRIMARY_STATE_UNCONFIGURED
    assert change(graph, Transition.TRANSITION_CONFIGURE)
    assert state(graph) == State.PRIMARY_STATE_INACTIVE
    heard = graph.listen(TablePlane, "table")
    publisher = graph.talk(PointCloud2, "points")
    graph.matched("points")
    graph.matched("table")
    publisher.publish(cloud_to_msg(scene_cloud(stamp_ns=1)))
    graph.until(lambda: node.statistics.summary().dropped == {"inactive": 1})
    assert change(graph, Transition.TRANSITION_ACTIVATE)
    publisher.publish(cloud_to_msg(scene_cloud(stamp_ns=2)))
    graph.until(lambda: heard)
    assert [message.header.stamp.nanosec for message in heard] == [2]
    assert change(graph, Transition.TRANSITION_DEACTIVATE)
    assert change(graph, Transition.TRANSITION_CLEANUP)
    assert state(graph) == State.PRIMARY_STATE_UNCONFIGURED
    assert graph.probe.count_publishers("/foretouch/table") == 0


def test_it_can_be_configured_again_after_cleaning_up(graph, scene_cloud):
    (node,) = graph.add("segmentation")
    for transition in (Transition.TRANSITION_DEACTIVATE, Transition.TRANSITION_CLEANUP, Transition.TRANSITION_CONFIGURE,
                       Transition.TRANSITION_ACTIVATE):  # fmt: skip
        assert change(graph, transition)
    heard = graph.listen(TablePlane, "table")
    publisher = graph.talk(PointCloud2, "points")
    graph.matched("points")
    graph.matched("table")
    publisher.publish(cloud_to_msg(scene_cloud()))
    graph.until(lambda: heard)
    graph.until(lambda: node.statistics.summary().used == 1)  # counted just after it was published


def test_a_transition_that_does_not_exist_is_refused(graph):
    graph.add("segmentation")
    assert not change(graph, Transition.TRANSITION_CONFIGURE)
    assert state(graph) == State.PRIMARY_STATE_ACTIVE


def test_a_best_effort_camera_is_heard(graph, scene_cloud):
    (node,) = graph.add("segmentation")
    publisher = graph.talk(PointCloud2, "points", reliable=False)
    graph.matched("points")
    publisher.publish(cloud_to_msg(scene_cloud()))
    graph.until(lambda: node.statistics.summary().used == 1)


def test_mismatched_qos_is_told_in_diagnostics(graph):
    graph.add("segmentation", **{"qos_overrides./foretouch/points.subscription.reliability": "reliable"})
    reports = graph.listen(DiagnosticArray, "/diagnostics")
    graph.probe.create_publisher(PointCloud2, "points", QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT))

    def told():
        return any(
            "points: a publisher has incompatible QoS (RELIABILITY)" in s.message for r in reports for s in r.status
        )

    graph.until(told)
    assert reports[-1].status[0].level == DiagnosticStatus.WARN


def test_qos_of_outputs_can_be_overridden(graph):
    graph.add("segmentation", **{"qos_overrides./foretouch/objects.publisher.reliability": "best_effort"})
    graph.listen(ObjectArray, "objects", reliable=False)
    graph.matched("objects")
    (info,) = graph.probe.get_publishers_info_by_topic("/foretouch/objects")
    assert info.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT


def test_diagnostics_tell_counts_ages_and_latencies(graph, scene_cloud):
    graph.add("segmentation", diagnostics_period_s=0.1)
    reports = graph.listen(DiagnosticArray, "/diagnostics")
    publisher = graph.talk(PointCloud2, "points")
    graph.matched("points")
    publisher.publish(cloud_to_msg(scene_cloud(stamp_ns=graph.probe.get_clock().now().nanoseconds)))

    def used():
        return reports and {v.key: v.value for v in reports[-1].status[0].values}.get("used") == "1"

    graph.until(used)
    (status,) = reports[-1].status
    known = {pair.key: pair.value for pair in status.values}
    assert status.name == "/foretouch/segmentation"
    assert known["received"] == "1"
    assert known["dropped"] == "0"
    assert known["answered.ok"] == "1"
    assert 0.0 < float(known["latency_ms.p50"]) <= float(known["latency_ms.p95"]) < 20_000
    assert float(known["input_age_ms.p50"]) > 0.0


def test_parameters_are_described_changed_and_refused_over_the_wire(graph):
    (node,) = graph.add("segmentation")
    name = "segmentation.clusters.min_height_m"
    request = DescribeParameters.Request(names=[name])
    (facts,) = graph.call(DescribeParameters, "segmentation/describe_parameters", request).descriptors
    assert facts.description
    assert facts.floating_point_range

    def set_to(value):
        wanted = ParameterMsg(name=name, value=ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=value))
        return graph.call(SetParameters, "segmentation/set_parameters", SetParameters.Request(parameters=[wanted]))

    assert set_to(0.01).results[0].successful
    assert node.config.segmentation.clusters.min_height_m == 0.01
    refused = set_to(-5.0).results[0]
    assert not refused.successful
    assert name in refused.reason
    assert node.config.segmentation.clusters.min_height_m == 0.01


def test_a_bad_parameter_at_the_start_is_one_line(graph):
    from rclpy.parameter import Parameter

    with pytest.raises(ConfigError, match=r"target\.mode|TargetConfig\.mode"):
        make_nodes("segmentation", parameter_overrides=[Parameter("target.mode", value="prettiest")])


def test_what_was_loaded_is_not_searched_for_garbage_while_a_node_is_active(graph):
    (node,) = graph.add("grasp")
    assert node.state_name == "active"
    assert gc.get_freeze_count() > 0
    node.trigger_deactivate()
    node.trigger_cleanup()
    assert gc.get_freeze_count() == 0
