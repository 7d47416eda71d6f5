# SPDX-License-Identifier: Apache-2.0
"""`use_sim_time`: the nodes work and report while the clock of a simulator stands, jumps ahead and jumps back."""

import pytest
from builtin_interfaces.msg import Time
from rclpy.qos import QoSProfile
from sensor_msgs.msg import PointCloud2

from foretouch.ros.messages.clouds import cloud_to_msg
from foretouch.types import stamp_ns
from foretouch_msgs.msg import RecorderStatus, Status, TouchPredictionArray

pytestmark = pytest.mark.ros
SECOND, HOUR = 10**9, 3600
CLOCKS = (100, 101, 100 + HOUR, 100, 2 * HOUR, 5)  # [s]


def test_clouds_are_answered_and_reports_go_on_whatever_the_clock_does(graph, scene_cloud, model_card, tmp_path):
    clock_type = pytest.importorskip("rosgraph_msgs.msg", reason="rosgraph_msgs is not installed").Clock
    own = {"perception": {"model": model_card}, "recorder": {"folder": str(tmp_path), "record": "main"}}
    common = {"use_sim_time": True, "diagnostics_period_s": 0.1}
    nodes = [graph.add(name, **common, **parameters)[0] for name, parameters in own.items()]
    heard, points = graph.listen(TouchPredictionArray, "touch"), graph.talk(PointCloud2, "points")
    clock = graph.probe.create_publisher(clock_type, "/clock", QoSProfile(depth=1))
    reports = {name: graph.reports(name) for name in own} | {"status": graph.listen(RecorderStatus, "recorder_status")}
    graph.matched("points", "touch")
    graph.until(lambda: clock.get_subscription_count() >= len(nodes))

    def check(now_s: int, status: int = Status.OK) -> None:
        """At a time of the clock, which stands meanwhile."""
        before = {name: len(found) for name, found in reports.items()}
        points.publish(cloud_to_msg(scene_cloud(stamp_ns=now_s * SECOND)))
        graph.until(lambda: heard and stamp_ns(heard[-1].header.stamp) == now_s * SECOND, 15.0)
        assert heard[-1].status == status, heard[-1].reason
        assert not any("late" in prediction.flags for prediction in heard[-1].predictions)
        graph.until(lambda: all(len(found) > before[name] for name, found in reports.items()), 15.0)

    check(50)  # no message on /clock yet: the time is 0
    for now_s in CLOCKS:
        clock.publish(clock_type(clock=Time(sec=now_s)))
        graph.until(lambda now_s=now_s: {node.get_clock().now().nanoseconds for node in nodes} == {now_s * SECOND})
        check(now_s)
    assert len(heard) == 1 + len(CLOCKS)
