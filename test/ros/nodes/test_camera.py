# SPDX-License-Identifier: Apache-2.0
"""The camera node over real DDS, on librealsense's own software device."""

from __future__ import annotations

import time
from importlib.util import find_spec

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rcl_interfaces.srv import SetParametersAtomically
from rclpy.parameter import Parameter
from sensor_msgs.msg import PointCloud2

from foretouch.camera import RealSenseConfig, SyntheticCamera, open_camera
from foretouch.dataset.messages import decode_cloud
from foretouch.errors import ConfigError
from foretouch.ros.nodes.camera import CameraNode
from foretouch.tactile.messages.table import stamp_ns

pytestmark = [
    pytest.mark.ros,
    pytest.mark.skipif(find_spec("pyrealsense2") is None, reason="pyrealsense2 is not installed"),
]

SMALL = {"camera__width": 212, "camera__height": 120, "camera__fps": 15, "diagnostics_period_s": 0.1}
QUICK = {
    "camera__timeouts__stall_s": 0.3,
    "camera__timeouts__reopen_s": 0.6,
    "camera__timeouts__start_s": 0.6,
    "camera__timeouts__backoff_min_s": 0.1,
    "camera__timeouts__backoff_max_s": 0.3,
}


def start(graph, source: str = "synthetic", **parameters) -> CameraNode:
    (node,) = graph.add("camera", source=source, **{**SMALL, **parameters})
    return node


def reports(graph) -> list[DiagnosticStatus]:
    """A list that fills with what the camera says of itself."""
    said: list[DiagnosticStatus] = []

    def hear(message: DiagnosticArray) -> None:
        said.extend(status for status in message.status if status.name == "/foretouch/camera")

    graph.probe.create_subscription(DiagnosticArray, "/diagnostics", hear, 10)
    return said


def values(status: DiagnosticStatus) -> dict[str, str]:
    return {pair.key: pair.value for pair in status.values}


def test_a_synthetic_camera_publishes_organised_clouds(graph):
    heard = graph.listen(PointCloud2, "points")
    before = time.time_ns()
    node = start(graph, synthetic__seed=3)
    graph.until(lambda: len(heard) >= 5)
    truths = [node.synthetic._frame(k).cloud().xyz for k in range(15)]
    stamps = [stamp_ns(message.header.stamp) for message in heard]
    assert stamps == sorted(set(stamps))
    assert before < stamps[0] < stamps[-1] < time.time_ns()
    for message in heard:
        assert (message.header.frame_id, message.height, message.width) == ("camera_depth_optical_frame", 120, 212)
        assert (message.point_step, message.row_step) == (12, 12 * 212)
        xyz = decode_cloud(message).xyz
        assert any(np.array_equal(xyz, truth, equal_nan=True) for truth in truths)


def test_colour_and_the_frame_are_as_asked(graph):
    heard = graph.listen(PointCloud2, "points")
    start(graph, camera__align="colour_to_depth", camera__frame_id="eye")
    graph.until(lambda: heard)
    cloud = decode_cloud(heard[0])
    assert (heard[0].header.frame_id, heard[0].point_step) == ("eye", 16)
    assert cloud.rgb is not None
    assert cloud.rgb.max() > 0


def test_a_stalled_camera_is_told_in_diagnostics_and_recovers(graph):
    heard, said = graph.listen(PointCloud2, "points"), reports(graph)
    node = start(graph, **QUICK)
    graph.until(
        lambda: heard and any(s.level == DiagnosticStatus.OK and values(s)["camera"] == "streaming" for s in said)
    )
    node.synthetic.pause()
    graph.until(lambda: any("stalled: no frame for" in s.message for s in said))
    graph.until(lambda: any("reconnecting: " in s.message for s in said))
    assert said[-1].level == DiagnosticStatus.ERROR
    count = len(heard)
    node.synthetic.start()
    graph.until(lambda: len(heard) > count)
    del said[:]
    graph.until(lambda: said and said[-1].level != DiagnosticStatus.ERROR and values(said[-1])["camera"] == "streaming")
    assert int(values(said[-1])["opened"]) >= 2


def test_an_unplugged_camera_is_told_and_comes_back(graph):
    heard, said = graph.listen(PointCloud2, "points"), reports(graph)
    node = start(graph, **QUICK)
    graph.until(lambda: heard)
    node.synthetic.unplug()
    graph.until(lambda: any("absent: " in s.message and "is unplugged; attempt" in s.message for s in said))
    count = len(heard)
    node.synthetic.plug()
    graph.until(lambda: len(heard) > count)


def test_an_absent_device_is_told_and_tried_again(graph):
    said = reports(graph)
    start(graph, "device", camera__serial="000000000000", **QUICK)
    graph.until(lambda: any(int(values(s).get("failures", 0)) >= 2 for s in said))
    assert said[-1].level == DiagnosticStatus.ERROR
    assert "absent: camera 000000000000: " in said[-1].message
    assert "attempt" in said[-1].message


def test_counts_add_up(graph):
    said = reports(graph)
    node = start(graph)
    graph.until(lambda: node.statistics.summary().used >= 5)
    node.trigger_deactivate()
    snapshot = node.statistics.summary()
    assert snapshot.received == snapshot.used + sum(snapshot.dropped.values())
    assert snapshot.waiting == 0
    assert said


def test_a_recording_is_played_once_and_the_node_ends(graph, tmp_path):
    path, stamps = tmp_path / "seen.db3", []
    heard = graph.listen(PointCloud2, "points")
    source = SyntheticCamera([_frame()], fps=15)
    config = RealSenseConfig(width=212, height=120, fps=15, record_to=str(path))
    with open_camera(config, source) as camera:
        camera.read(0.0)
        for _ in range(4):
            source.feed()
            cloud = camera.read(1.0)
            assert cloud is not None
            stamps.append(cloud.stamp_ns)
    node = start(graph, str(path), camera__real_time=False, autostart=False)
    node.trigger_configure()
    graph.matched("points")
    node.trigger_activate()
    graph.until(node.has_ended)
    graph.until(lambda: len(heard) >= 4)
    assert [stamp_ns(message.header.stamp) for message in heard] == stamps
    np.testing.assert_array_equal(decode_cloud(heard[-1]).xyz, cloud.xyz)


def _frame():
    from foretouch.simulation import random_scene

    return random_scene(np.random.default_rng(5), 212, 120).render()


def test_a_missing_recording_refuses_to_be_activated(graph, tmp_path, capfd):
    node = start(graph, str(tmp_path / "gone.db3"))
    assert node.state_name == "inactive"
    assert "gone.db3: no such file" in capfd.readouterr().err


def test_a_file_that_is_no_recording_is_an_error_in_diagnostics(graph, tmp_path):
    said = reports(graph)
    (tmp_path / "bad.db3").write_bytes(b"no recording")
    start(graph, str(tmp_path / "bad.db3"))
    graph.until(lambda: any("bad.db3: not a RealSense recording" in s.message for s in said))


def test_it_can_be_deactivated_and_activated_again(graph):
    heard = graph.listen(PointCloud2, "points")
    node = start(graph)
    graph.until(lambda: heard)
    node.trigger_deactivate()
    time.sleep(0.3)
    count = len(heard)
    time.sleep(0.3)
    assert len(heard) == count
    node.trigger_activate()
    graph.until(lambda: len(heard) > count)


def test_filters_change_while_it_streams_and_the_rest_is_refused(graph):
    heard = graph.listen(PointCloud2, "points")
    start(graph)
    graph.until(lambda: heard)

    def change(name: str, value: object):
        request = SetParametersAtomically.Request(parameters=[Parameter(name, value=value).to_parameter_msg()])
        return graph.call(SetParametersAtomically, "/foretouch/camera/set_parameters_atomically", request).result

    assert change("camera.filters.decimation.enabled", value=True).successful
    graph.until(lambda: heard[-1].width < 110)  # half of 212, rounded as the library does
    assert not change("camera.width", value=640).successful
    refused = change("camera.timeouts.stall_s", value=50.0)
    assert not refused.successful
    assert "TimeoutConfig.stall_s: 50.0 is above reopen_s" in refused.reason


def test_contradicting_parameters_stop_the_node_from_being_made(graph):
    with pytest.raises(ConfigError, match="exclude each other"):
        graph.add("camera", camera__file="a.db3", camera__serial="1")
