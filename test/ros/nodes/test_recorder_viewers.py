# SPDX-License-Identifier: Apache-2.0
"""What a live recording keeps beside its samples, as tools without foretouch read it."""

import sys
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest
from other_tools import rerun_components, rosbags_messages
from rclpy.qos import DurabilityPolicy, QoSProfile
from robot_builders import FRAME, QUICK, RecordedRobot, accounts
from rosbags.typesys import Stores, get_typestore
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from foretouch.dataset.recordings.reader import RecordedDataset
from foretouch.dataset.recordings.verify import verify_dataset
from foretouch.ros.messages.conversions import header_to_msg

pytestmark = pytest.mark.ros
LATCHED = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
TYPES = get_typestore(Stores.ROS2_KILTED)


class TFMessage(String):
    """Stands for tf2_msgs/TFMessage, which no wheel of PyPI holds: only its bytes are sent."""


TFMessage.__module__ = "tf2_msgs.msg._tf_message"


@pytest.fixture
def tf2_msgs(monkeypatch: pytest.MonkeyPatch) -> None:
    module = ModuleType("tf2_msgs.msg")
    module.TFMessage = TFMessage
    monkeypatch.setitem(sys.modules, "tf2_msgs", ModuleType("tf2_msgs"))
    monkeypatch.setitem(sys.modules, "tf2_msgs.msg", module)


def transform(parent: str, child: str, stamp_ns: int) -> bytes:
    """The CDR of a tf2_msgs/TFMessage with one transform."""
    stamp = SimpleNamespace(sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
    one = SimpleNamespace(
        header=SimpleNamespace(stamp=stamp, frame_id=parent),
        child_frame_id=child,
        transform=SimpleNamespace(
            translation=SimpleNamespace(x=0.1, y=0.2, z=0.3), rotation=SimpleNamespace(x=0.0, y=0.0, z=0.0, w=1.0)
        ),
    )
    return bytes(TYPES.serialize_cdr(SimpleNamespace(transforms=[one]), "tf2_msgs/msg/TFMessage"))


def send_all(robot: RecordedRobot, moving: Any, joints: Any) -> None:
    """A transform of the wrist, and the joints."""
    moving.publish(transform("world", "rh_wrist", robot.now))
    joints.publish(JointState(header=header_to_msg("", robot.now), name=["rh_FFJ1"], position=[0.5]))


@pytest.mark.usefixtures("tf2_msgs")
def test_other_tools_see_cloud_transforms_joints_and_robot(graph, tmp_path):
    fixed = graph.probe.create_publisher(TFMessage, "/tf_static", LATCHED)
    robot_text = graph.probe.create_publisher(String, "/robot_description", LATCHED)
    moving, joints = graph.talk(TFMessage, "/tf"), graph.talk(JointState, "/joint_states")
    (node,) = graph.add("recorder", folder=str(tmp_path), **QUICK)
    topics = ("/tf", "/tf_static", "/robot_description", "/joint_states")
    graph.matched(*topics)
    robot = RecordedRobot(graph, node)
    before = transform("world", FRAME, robot.now - 10**9)
    fixed.publish(before)
    robot_text.publish(String(data="<robot name='hand'><link name='rh_wrist'/></robot>"))
    graph.until(lambda: {"/tf_static", "/robot_description"} <= accounts(node.status()).keys())
    assert "/tf" not in accounts(node.status())  # nothing is reported of what nobody publishes
    for session in range(2):  # what was latched is in each of them
        node.begin(str(tmp_path / "set"), "can")
        send_all(robot, moving, joints)
        robot.record(f"g-{session}", session)
        graph.until(lambda: all(accounts(node.status())[topic].written for topic in topics))
        status = node.end()
        assert status.message.samples == 1
    reports = verify_dataset(tmp_path / "set")
    assert [report.fault_lines() for report in reports] == [[], []]
    for number, report in enumerate(reports):
        (tmp_path / str(number)).mkdir()
        messages = rosbags_messages(report.path)
        assert len(messages["/tf_static"]) == len(messages["/robot_description"]) == 1
        assert messages["/tf_static"][0].transforms[0].child_frame_id == FRAME
        assert messages["/joint_states"][0].name == ["rh_FFJ1"]
        (cloud,) = messages["/foretouch/object_cloud"]
        record = RecordedDataset(tmp_path / "set")[number]
        assert cloud.width == record.cloud.size
        seen = rerun_components(report.path, tmp_path / str(number))
        assert {"Points3D:positions", "CoordinateFrame:frame"} <= seen["/foretouch/object_cloud"]
        for entity in ("/tf", "/tf_static"):
            assert {"Transform3D:parent_frame", "Transform3D:child_frame"} <= seen[entity]
