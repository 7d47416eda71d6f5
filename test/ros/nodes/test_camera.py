# SPDX-License-Identifier: Apache-2.0
"""The camera node over real DDS, on librealsense's own software device."""

import time
from functools import partial
from importlib.util import find_spec

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from rcl_interfaces.srv import SetParametersAtomically
from rclpy.parameter import Parameter
from sensor_msgs.msg import PointCloud2

from foretouch.camera.config import RealSenseConfig
from foretouch.camera.realsense import RealSenseCamera
from foretouch.cloud.messages import decode_cloud
from foretouch.errors import ConfigError
from foretouch.tactile.messages.table import stamp_ns
from foretouch_lab.simulation import random_scene
from foretouch_lab.simulation.software_camera import SyntheticCamera

pytestmark = [
    pytest.mark.ros,
    pytest.mark.skipif(find_spec("pyrealsense2") is None, reason="pyrealsense2 is not installed"),
]

SMALL = {"camera__width": 212, "camera__height": 120, "camera__fps": 15, "diagnostics_period_s": 0.1}
LIMITS = {"stall_s": 0.3, "reopen_s": 0.6, "start_s": 0.6, "backoff_min_s": 0.1, "backoff_max_s": 0.3}
QUICK = {f"camera__timeouts__{name}": value for name, value in LIMITS.items()}


@pytest.fixture
def scene_file(tmp_path):
    """A scene of small images; each sample stays for a tenth of a second."""
    path = tmp_path / "scene.yaml"
    path.write_text("camera: {width: 212, height: 120}\nobjects: [{name: can, size_m: [0.07, 0.07, 0.1]}]")
    return {"scene__path": str(path), "scene__dwell_s": 0.1}


def start(graph, source="scene", **parameters):
    """The node, the clouds that it publishes, and its reports."""
    heard, reports = graph.listen(PointCloud2, "points"), graph.reports("camera")
    (node,) = graph.add("camera", source=source, **{**SMALL, **parameters})
    return node, heard, reports


def plug(node, *, on):
    node.synthetic.plugged = on


def is_streaming(reports):
    return reports and reports[-1].level == DiagnosticStatus.OK and reports[-1].values["camera"] == "streaming"


def test_the_camera_of_a_scene_publishes_organised_clouds(graph, scene_file):
    before = time.time_ns()
    node, heard, reports = start(graph, **scene_file)
    graph.until(lambda: len(heard) >= 5)
    stamps = [stamp_ns(message.header.stamp) for message in heard]
    assert stamps == sorted(set(stamps))
    assert before < stamps[0] < stamps[-1] < time.time_ns()
    for message in heard:
        assert (message.header.frame_id, message.height, message.width) == ("camera_depth_optical_frame", 120, 212)
        assert (message.point_step, message.row_step) == (12, 12 * 212)
        xyz = decode_cloud(message).xyz
        assert np.isfinite(xyz).all(axis=-1).mean() > 0.9
    node.trigger_deactivate()
    summary = node.statistics.summary()
    assert (summary.received, summary.waiting) == (summary.used + sum(summary.dropped.values()), 0)
    time.sleep(0.2)
    count = len(heard)
    time.sleep(0.3)
    assert (len(heard), bool(reports)) == (count, True)
    node.trigger_activate()
    graph.until(lambda: len(heard) > count)


def test_a_stalled_or_unplugged_camera_is_named_in_diagnostics_and_comes_back(graph, scene_file):
    node, heard, reports = start(graph, **QUICK, **scene_file)
    for fault, end, texts in (
        (node.synthetic.pause, node.synthetic.start, ("stalled: no frame for", "reconnecting: ")),
        (partial(plug, node, on=False), partial(plug, node, on=True), ("absent: ", "is unplugged; attempt")),
    ):
        graph.until(lambda: heard and is_streaming(reports))
        fault()
        for text in texts:
            graph.until(lambda text=text: any(text in one.message for one in reports))
        assert reports[-1].level == DiagnosticStatus.ERROR
        end()
        del heard[:], reports[:]
        graph.until(lambda: heard and is_streaming(reports))
        assert int(reports[-1].values["opened"]) >= 2


def test_a_recording_is_played_once_and_the_node_ends(graph, tmp_path):
    path, stamps = str(tmp_path / "seen.db3"), []
    source = SyntheticCamera([random_scene(np.random.default_rng(5), 212, 120).render()], fps=15)
    with RealSenseCamera(RealSenseConfig(width=212, height=120, fps=15, record_to=path), source) as camera:
        camera.read(0.0)
        for _ in range(4):
            source.feed()
            cloud = camera.read(1.0)
            stamps.append(cloud.stamp_ns)
    node, heard, _ = start(graph, path, camera__real_time=False, autostart=False)
    node.trigger_configure()
    graph.matched("points")
    node.trigger_activate()
    graph.until(node.has_ended)
    graph.until(lambda: len(heard) >= 4)
    assert [stamp_ns(message.header.stamp) for message in heard] == stamps
    np.testing.assert_array_equal(decode_cloud(heard[-1]).xyz, cloud.xyz)


def test_a_recording_that_is_missing_or_none_and_parameters_that_exclude_each_other_are_named(graph, tmp_path, capfd):
    node, *_ = start(graph, str(tmp_path / "gone.db3"))
    assert node.state_name == "inactive"
    assert "gone.db3: no such file" in capfd.readouterr().err
    graph.remove(node)
    (tmp_path / "bad.db3").write_bytes(b"no recording")
    _, _, reports = start(graph, str(tmp_path / "bad.db3"))
    graph.until(lambda: any("bad.db3: not a RealSense recording" in one.message for one in reports))
    with pytest.raises(ConfigError, match="exclude each other"):
        graph.add("camera", camera__file="a.db3", camera__serial="1")


def test_timeouts_change_while_it_streams_and_the_rest_is_refused(graph, scene_file):
    _, heard, _ = start(graph, **scene_file, camera__filters=["decimation"], camera__frame_id="eye")
    graph.until(lambda: heard)
    assert heard[0].header.frame_id == "eye"
    assert heard[0].width < 110  # half of 212, rounded as the library does

    def change(name, value):
        request = SetParametersAtomically.Request(parameters=[Parameter(name, value=value).to_parameter_msg()])
        return graph.call(SetParametersAtomically, "camera/set_parameters_atomically", request).result

    assert change("camera.timeouts.stall_s", value=0.5).successful
    assert not change("camera.width", value=640).successful
    refused = change("camera.timeouts.stall_s", value=50.0)
    assert (refused.successful, "stall_s: 50.0 is above reopen_s" in refused.reason) == (False, True)
