# SPDX-License-Identifier: Apache-2.0
"""The camera node over real DDS, on librealsense's own software device."""

import json
import time
from functools import partial
from importlib.util import find_spec

import numpy as np
import pytest
from camera_builders import record
from diagnostic_msgs.msg import DiagnosticStatus
from sensor_msgs.msg import CameraInfo, Image, PointCloud2
from sim_builders import CAN, scene

from benchmarks.random_scenes import random_scene
from foretouch.camera.config import RealSenseConfig
from foretouch.cloud.io.depth_messages import CameraInfos, camera_model
from foretouch.cloud.messages import decode_cloud
from foretouch.errors import ConfigError
from foretouch.types import stamp_ns
from foretouch_lab.simulation.software_camera import SyntheticCamera

pytestmark = [
    pytest.mark.ros,
    pytest.mark.skipif(find_spec("pyrealsense2") is None, reason="pyrealsense2 is not installed"),
]

SHOWN = scene(CAN, camera={"width": 212, "height": 160})


@pytest.fixture
def start(graph, tmp_path):
    """Starts the node; gives it, the clouds that it publishes, and its reports."""

    def run(source="scene", **parameters):
        (tmp_path / "scene.yaml").write_text(json.dumps(SHOWN.to_mapping()), encoding="utf-8")
        heard, reports = graph.listen(PointCloud2, "points"), graph.reports("camera")
        shown = {"scene__path": str(tmp_path / "scene.yaml")} if source == "scene" else {}
        defaults = {"camera__fps": 15, "diagnostics_period_s": 0.1, **shown}
        (node,) = graph.add("camera", source=source, **{**defaults, **parameters})
        return node, heard, reports

    return run


def plug(node, *, on):
    node.synthetic.plugged = on


def is_streaming(reports):
    return reports and reports[-1].level == DiagnosticStatus.OK and reports[-1].values["camera"] == "streaming"


def test_a_camera_publishes_organised_clouds_while_it_is_active(graph, start):
    before = time.time_ns()
    node, heard, reports = start()
    graph.until(lambda: len(heard) >= 5)
    stamps = [stamp_ns(message.header.stamp) for message in heard]
    assert stamps == sorted(set(stamps))
    assert before < stamps[0] < stamps[-1] < time.time_ns()
    for message in heard:
        assert (message.header.frame_id, message.height, message.width) == ("camera_depth_optical_frame", 160, 212)
        assert (message.point_step, message.row_step) == (12, 12 * 212)
    node.trigger_deactivate()
    summary = node.statistics.summary()
    assert (summary.received, summary.waiting) == (summary.used + sum(summary.dropped.values()), 0)
    time.sleep(0.2)
    count = len(heard)
    time.sleep(0.3)
    assert (len(heard), bool(reports)) == (count, True)
    node.trigger_activate()
    graph.until(lambda: len(heard) > count)


def test_depth_images_have_the_names_of_realsense2_camera_and_the_points_of_the_clouds(graph, start):
    images = graph.listen(Image, "depth/image_rect_raw")
    infos = graph.listen(CameraInfo, "depth/camera_info")
    _, heard, _ = start()
    graph.until(lambda: min(map(len, (heard, images, infos))) >= 3)
    clouds = {stamp_ns(message.header.stamp): decode_cloud(message) for message in heard}
    both = [message for message in images if stamp_ns(message.header.stamp) in clouds]
    assert both
    known = CameraInfos("depth/image_rect_raw")
    known.add(infos[0], 0.0)
    for message in both:
        assert (message.encoding, message.step, message.header.frame_id) == ("16UC1", 424, "camera_depth_optical_frame")
        cloud = known.cloud(message, 0.0)
        np.testing.assert_array_equal(cloud.xyz, clouds[cloud.stamp_ns].xyz)
    assert {stamp_ns(message.header.stamp) for message in infos[1:]} <= {
        stamp_ns(message.header.stamp) for message in images
    } | {stamp_ns(infos[-1].header.stamp)}
    assert camera_model(infos[0], rectified=True) == camera_model(infos[0])


def test_colours_have_the_header_and_the_pixels_of_their_depth_image(graph, start):
    images = graph.listen(Image, "depth/image_rect_raw")
    colours = graph.listen(Image, "color/image")
    node, heard, reports = start(camera__color=True)
    graph.until(lambda: min(map(len, (heard, images, colours))) >= 3 and reports)
    depths = {stamp_ns(message.header.stamp): message for message in images}
    clouds = {stamp_ns(message.header.stamp): decode_cloud(message) for message in heard}
    both = [message for message in colours if stamp_ns(message.header.stamp) in depths.keys() & clouds.keys()]
    assert both
    for message in both:
        depth = depths[stamp_ns(message.header.stamp)]
        assert message.header == depth.header
        assert (message.encoding, message.height, message.width, message.step) == ("rgb8", 160, 212, 636)
        rgb = np.frombuffer(message.data, np.uint8).reshape(160, 212, 3)
        np.testing.assert_array_equal(rgb, clouds[stamp_ns(message.header.stamp)].rgb)
        assert len(np.unique(rgb.reshape(-1, 3), axis=0)) > 10
    assert int(reports[-1].values["without_color"]) == node._camera.status.colourless == 0


def test_a_cloud_is_made_only_for_a_subscriber(graph, monkeypatch, tmp_path):
    made = []
    monkeypatch.setattr("foretouch.ros.nodes.camera.cloud_to_msg", made.append)
    (tmp_path / "scene.yaml").write_text(json.dumps(SHOWN.to_mapping()), encoding="utf-8")
    images = graph.listen(Image, "depth/image_rect_raw")
    graph.add("camera", source="scene", scene__path=str(tmp_path / "scene.yaml"), camera__fps=15)
    graph.until(lambda: len(images) >= 5)
    assert not made


def test_a_stalled_or_unplugged_camera_is_named_in_diagnostics_and_comes_back(graph, start):
    node, heard, reports = start(camera__silence_s=0.9)
    for fault, end, texts in (
        (node.synthetic.pause, node.synthetic.start, ("stalled: no frame for", "reconnecting: ")),
        (partial(plug, node, on=False), partial(plug, node, on=True), ("absent: ", "is unplugged; attempt")),
    ):
        graph.until(lambda: heard and is_streaming(reports))
        fault()
        for text in texts:
            graph.until(lambda text=text: any(text in report.message for report in reports))
        assert reports[-1].level == DiagnosticStatus.ERROR
        end()
        del heard[:], reports[:]
        graph.until(lambda: heard and is_streaming(reports))
        assert int(reports[-1].values["opened"]) >= 2


def test_a_recording_is_played_once_and_the_node_ends_and_what_is_none_is_named(graph, start, tmp_path, capfd):
    source = SyntheticCamera([random_scene(np.random.default_rng(5), 212, 120).render()], fps=15)
    recorded = record(tmp_path / "seen.db3", source, RealSenseConfig(width=212, height=120, fps=15), 4)
    node, heard, _ = start(str(tmp_path / "seen.db3"), camera__real_time=False, autostart=False)
    node.trigger_configure()
    graph.matched("points")
    node.trigger_activate()
    graph.until(node.has_ended)
    graph.until(lambda: len(heard) >= 4)
    assert [stamp_ns(message.header.stamp) for message in heard] == [cloud.stamp_ns for cloud in recorded]
    np.testing.assert_array_equal(decode_cloud(heard[-1]).xyz, recorded[-1].xyz)
    graph.remove(node)
    node, *_ = start(str(tmp_path / "gone.db3"))
    assert node.state_name == "inactive"
    assert "gone.db3: no such file" in capfd.readouterr().err
    graph.remove(node)
    (tmp_path / "bad.db3").write_bytes(b"no recording")
    _, _, reports = start(str(tmp_path / "bad.db3"))
    graph.until(lambda: any("bad.db3: not a RealSense recording" in report.message for report in reports))
    with pytest.raises(ConfigError, match="exclude each other"):
        graph.add("camera", camera__file="a.db3", camera__serial="1")
