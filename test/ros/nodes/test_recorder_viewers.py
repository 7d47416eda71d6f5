# SPDX-License-Identifier: Apache-2.0
"""What a live recording keeps beside its samples, as tools without foretouch read it."""

import sys
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import Point
from other_tools import foxglove_counts, foxglove_faults, rerun_components, rosbags_messages
from rclpy.qos import DurabilityPolicy, QoSProfile
from robot_builders import FRAME, QUICK, RecordedRobot, accounts
from rosbags.typesys import Stores, get_typestore
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from visualization_msgs.msg import Marker, MarkerArray

from foretouch.dataset.recording.reader import RecordedDataset
from foretouch.dataset.recording.verify import verify_dataset
from foretouch.ros.messages.conversions import header_to_msg
from foretouch.ros.recorder.subscriptions import VIEWER_TOPICS

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


def send_all(graph: Any, robot: RecordedRobot, moving: Any, joints: Any, markers: Any) -> None:
    """A transform of the wrist, the joints, and a marker in the frame of the hand."""
    moving.publish(transform("world", "rh_wrist", robot.now))
    joints.publish(JointState(header=header_to_msg("", robot.now), name=["rh_FFJ1"], position=[0.5]))
    ball = Marker(header=header_to_msg("rh_wrist", robot.now), type=Marker.SPHERE, points=[Point()])
    markers.publish(MarkerArray(markers=[ball]))


@pytest.mark.usefixtures("tf2_msgs")
def test_other_tools_see_cloud_taxels_transforms_joints_robot_and_markers(graph, tmp_path):
    fixed = graph.probe.create_publisher(TFMessage, "/tf_static", LATCHED)
    robot_text = graph.probe.create_publisher(String, "/robot_description", LATCHED)
    moving, joints = graph.talk(TFMessage, "/tf"), graph.talk(JointState, "/joint_states")
    markers = graph.talk(MarkerArray, "markers")
    (node,) = graph.add("recorder", folder=str(tmp_path), viewer_topics=list(VIEWER_TOPICS), **QUICK)
    topics = ("/tf", "/tf_static", "/robot_description", "/joint_states", "markers")
    graph.matched(*topics)
    robot = RecordedRobot(graph, node)
    before = transform("world", FRAME, robot.now - 10**9)
    fixed.publish(before)
    robot_text.publish(String(data="<robot name='hand'><link name='rh_wrist'/></robot>"))
    graph.until(lambda: {"/tf_static", "/robot_description"} <= accounts(node.status()).keys())
    assert "/tf" not in accounts(node.status())  # nothing is reported of what nobody publishes
    for session in range(2):  # what was latched is in each of them
        node.begin(str(tmp_path / "set"), "can")
        send_all(graph, robot, moving, joints, markers)
        robot.record(f"g-{session}", session)
        graph.until(lambda: all(accounts(node.status())[topic].written for topic in topics))
        status = node.end()
        assert status.samples == 1
    reports = verify_dataset(tmp_path / "set")
    assert [report.fault_lines() for report in reports] == [[], []]
    for number, report in enumerate(reports):
        (tmp_path / str(number)).mkdir()
        messages = rosbags_messages(report.path)
        assert len(messages["/tf_static"]) == len(messages["/robot_description"]) == 1
        assert messages["/tf_static"][0].transforms[0].child_frame_id == FRAME
        assert messages["/joint_states"][0].name == ["rh_FFJ1"]
        assert messages["/foretouch/markers"][0].markers[0].header.frame_id == "rh_wrist"
        (cloud,) = messages["/foretouch/object_cloud"]
        record = RecordedDataset(tmp_path / "set")[number].record
        assert cloud.width == record.sample.cloud.size
        check_taxels(messages, record)
        (drawn,) = messages["/foretouch/sample_markers"]
        assert drawn.markers[-1].text.startswith(f"{record.sample.id}: PDC {record.sample.touch['PDC_TH'][0]:.0f} | ")
        assert {one.ns for one in drawn.markers} == {"contacts", "hand", "thumb", "middle_finger", "prediction"}
        assert {one.header.frame_id for one in drawn.markers} == {FRAME}
        assert list(foxglove_faults(report.path)) == []
        seen = rerun_components(report.path, tmp_path / str(number))
        for entity in ("/foretouch/object_cloud", "/foretouch/taxels/thumb", "/foretouch/taxels/middle_finger"):
            assert {"Points3D:positions", "CoordinateFrame:frame"} <= seen[entity]
            assert entity.endswith("cloud") or {f"Points3D:{name}" for name in ("electrode", "pdc")} <= seen[entity]
        for entity in ("/tf", "/tf_static"):
            assert {"Transform3D:parent_frame", "Transform3D:child_frame"} <= seen[entity]


def check_taxels(messages: dict[str, list[Any]], record: Any) -> None:
    """All readings of the series, at the contacts, with one field for each channel."""
    sample, series = record.sample, record.series
    for topic, contact, finger, first in (
        ("thumb", sample.grasp.g1, "TH", 2),
        ("middle_finger", sample.grasp.g2, "MF", 26),
    ):
        taxels = messages[f"/foretouch/taxels/{topic}"]
        assert [one.header.stamp.sec * 10**9 + one.header.stamp.nanosec for one in taxels] == series.stamps_ns.tolist()
        assert [field.name for field in taxels[0].fields] == [
            "x", "y", "z", "electrode", "pdc", "pac0", "pac1", "tac", "tdc"
        ]  # fmt: skip
        assert {(field.datatype, field.count) for field in taxels[0].fields} == {(7, 1)}
        points = np.stack([one.data.view(np.float32).reshape(24, 9) for one in taxels])
        np.testing.assert_array_equal(points[:, :, 3], series.counts[:, first : first + 24])
        np.testing.assert_array_equal(points[:, :, 4], np.repeat(series.counts[:, [int(finger == "MF")]], 24, axis=1))
        np.testing.assert_array_equal(points[:, 0, 8], series.others[f"TDC_{finger}"])
        assert np.linalg.norm(points[0, :, :3] - contact, axis=1).max() < 0.02
        assert {one.header.frame_id for one in taxels} == {FRAME}


@pytest.mark.slow
def test_the_libraries_of_foxglove_decode_every_message_by_its_schema(graph, tmp_path):
    (node,) = graph.add("recorder", folder=str(tmp_path), **QUICK)
    robot = RecordedRobot(graph, node)
    node.begin(str(tmp_path / "set"), "can")
    robot.record("g", 1)
    node.end()
    (report,) = verify_dataset(tmp_path / "set")
    expected = {topic: len(found) for topic, found in rosbags_messages(report.path).items()}
    assert foxglove_counts(report.path, tmp_path) == expected
    assert len(expected) == 8
