# SPDX-License-Identifier: Apache-2.0
"""Recordings through the whole graph over real DDS: one answer a cloud, equal to the pipeline's own."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

import torch
from recording_builders import SceneRecordingConfig, record_scenes, scene_clouds
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from foretouch.cloud.io.files import write_cloud
from foretouch.dataset.bag import POINT_CLOUD_TYPE, Recording, read_bag
from foretouch.dataset.bag_writer import BagWriter, serialize_cloud, write_bag
from foretouch.dataset.source import STAMP_STEP_NS, open_source
from foretouch.grasp import LiveGeoGraspConfig
from foretouch.models.network.checkpoint import save_network
from foretouch.models.network.config import ModelConfig
from foretouch.models.network.networks import TouchNet
from foretouch.pipeline import Pipeline, PipelineConfig, PipelineResult
from foretouch.ros.nodes.replay import ReplayNode
from foretouch.tactile.messages.table import stamp_ns
from foretouch.types import Cloud, Plane
from foretouch_msgs.msg import Status, TouchPredictionArray

pytestmark = pytest.mark.ros

EXAMPLES = Path(__file__).parents[2] / "examples"
STORE = get_typestore(Stores.ROS2_KILTED)
SCENES = SceneRecordingConfig(count=6, width=424, height=240, seed=3)


@pytest.fixture(scope="module")
def model(tmp_path_factory) -> str:
    """A small network with random weights: what it says is nonsense, and the same nonsense everywhere."""
    config = ModelConfig(
        n_points=64, trunk_widths=(16, 32), tnet_widths=(8, 8, 16, 8, 8), head_widths=(32,), metric_inputs=True
    )
    torch.manual_seed(1)
    return str(save_network(tmp_path_factory.mktemp("model"), "tiny", TouchNet(config).eval(), {}))


@pytest.fixture(scope="module")
def recording(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("recording") / "scenes"
    record_scenes(path, SCENES)
    return path


def play(graph, path: Path, model: str, **parameters) -> tuple[ReplayNode, list[TouchPredictionArray]]:
    """The four nodes and a subscriber; returns when the replay has ended."""
    received = graph.listen(TouchPredictionArray, "touch")
    graph.add("segmentation")
    graph.add("grasp", grasp_hold=0.0)  # so that each cloud is answered as it would be alone
    graph.add("touch_predictor", model=model)
    options = {"path": str(path), "lockstep": True, "rate_hz": 1000.0, "discovery_s": 0.0, **parameters}
    (replay,) = graph.add("replay", **options)
    assert replay.ended.wait(60.0)
    assert (replay.outcome, replay.unanswered) == ("finished", 0)
    graph.until(lambda: len(received) >= replay.played[replay.clouds_topic])
    return replay, received


def assert_same(message: TouchPredictionArray, cloud: Cloud, result: PipelineResult) -> None:
    """Stamp and frame are the cloud's; contacts, rotation and all 50 values are those of the pipeline, bit for bit."""
    expected = [one for felt in result.targets for one in felt.predictions]
    assert (stamp_ns(message.header.stamp), message.header.frame_id) == (cloud.stamp_ns, cloud.frame_id)
    assert len(message.predictions) == len(expected)
    for got, wanted in zip(message.predictions, expected, strict=True):
        assert got.header == message.header
        assert [got.grasp.g1.x, got.grasp.g1.y, got.grasp.g1.z] == wanted.grasp.g1.tolist()
        assert [got.grasp.g2.x, got.grasp.g2.y, got.grasp.g2.z] == wanted.grasp.g2.tolist()
        assert got.grasp.rotation.tolist() == wanted.grasp.rotation.reshape(9).tolist()
        intervals = [got.pdc_th, got.pdc_mf, *got.e_th, *got.e_mf]
        values = np.array([interval.value for interval in intervals], np.float32)
        np.testing.assert_array_equal(values, wanted.value.vector().astype(np.float32))


def test_a_recording_gets_one_answer_a_cloud_equal_to_the_pipeline(graph, recording, model):
    pipeline = Pipeline(PipelineConfig(model=model, grasp=LiveGeoGraspConfig()))
    _, received = play(graph, recording, model)
    clouds = list(read_bag(recording))
    assert len(received) == len(clouds) == SCENES.count
    results = [pipeline.run(cloud) for cloud in clouds]
    for message, cloud, result in zip(received, clouds, results, strict=True):
        assert_same(message, cloud, result)
    assert sum(bool(result.targets) for result in results) == SCENES.count


def test_at_the_recorded_pace_nothing_is_lost(graph, recording, model):
    _, received = play(graph, recording, model, lockstep=False, rate_hz=3.0)
    stamps = [cloud.stamp_ns for cloud in read_bag(recording)]
    assert [stamp_ns(message.header.stamp) for message in received] == stamps


def test_a_bag_of_others_gets_the_same_touch(graph, recording, model, tmp_path):
    clouds = list(read_bag(recording))
    write_foreign(tmp_path / "foreign", clouds)
    with Recording(tmp_path / "foreign") as foreign:
        assert foreign.content(next(foreign.messages())).is_bigendian
    pipeline = Pipeline(PipelineConfig(model=model, grasp=LiveGeoGraspConfig()))
    _, received = play(graph, tmp_path / "foreign", model)
    assert len(received) == len(clouds)
    for message, cloud in zip(received, clouds, strict=True):
        assert_same(message, cloud, pipeline.run(cloud))


def test_a_folder_of_objects_gets_one_answer_a_file_behind_the_segmentation(graph, model, tmp_path):
    pipeline = Pipeline(PipelineConfig(model=model, grasp=LiveGeoGraspConfig()))
    sight = pipeline.segment(next(iter(scene_clouds(SCENES))))
    for number, segment in enumerate(sight.segmentation.objects):
        write_cloud(tmp_path / f"object{number}.npz", segment.cloud)
    plane = sight.segmentation.plane
    _, received = play(graph, tmp_path, model, table=plane.coefficients.tolist())
    items = list(open_source(tmp_path, frame_id="camera_depth_optical_frame"))
    assert len(received) == len(items) == SCENES.objects
    for number, (message, item) in enumerate(zip(received, items, strict=True), 1):
        assert item.cloud.stamp_ns == number * STAMP_STEP_NS
        assert_same(message, item.cloud, pipeline.run_object(item.cloud, Plane.from_coefficients(plane.coefficients)))


def test_clouds_that_say_nothing_are_answered_with_the_reason(graph, model, tmp_path):
    scene = next(iter(scene_clouds(SCENES)))
    nowhere = np.full_like(scene.xyz, np.nan)
    with BagWriter(tmp_path / "bag") as writer:
        writer.write_cloud(Cloud(np.empty((0, 3), np.float32), None, "lens", 1))
        writer.write_cloud(Cloud(nowhere, None, "lens", 2))
        writer.write_cloud(Cloud(scene.xyz, None, "", 3))
        writer.write("/foretouch/points", POINT_CLOUD_TYPE, 4, with_wrong_width(scene, 4))
        writer.write_cloud(Cloud(scene.xyz, None, "lens", 5))
    _, received = play(graph, tmp_path / "bag", model)
    assert [stamp_ns(message.header.stamp) for message in received] == [1, 2, 3, 4, 5]
    statuses = [message.status for message in received]
    assert statuses[0] == statuses[1] == Status.EMPTY_CLOUD
    assert statuses[2] == Status.UNKNOWN_FRAME
    assert all(message.reason and not message.predictions for message in received[:4])
    assert received[4].predictions


def test_a_program_with_nothing_but_rclpy_hears_every_touch(graph, recording, model):
    listener = subprocess.Popen(
        [sys.executable, str(EXAMPLES / "listen_touch.py"), "--count", str(SCENES.count)],
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "ROS_DOMAIN_ID": str(graph.domain)},
    )
    try:
        graph.until(lambda: graph.probe.count_subscribers("/foretouch/touch") > 0)
        play(graph, recording, model)
        printed, _ = listener.communicate(timeout=30.0)
    finally:
        listener.kill()
    heard = list(dict.fromkeys(line.split(":")[0] for line in printed.splitlines()))
    stamps = [divmod(cloud.stamp_ns, 10**9) for cloud in read_bag(recording)]
    assert heard == [f"{sec}.{ns:09d} {SCENES.frame_id}" for sec, ns in stamps]
    assert "thumb PDC" in printed


@pytest.mark.real_data
def test_real_samples_get_one_answer_each_equal_to_the_pipeline(graph, real_data, model):
    folder = real_data / "vision2tactile" / "rugby"
    pipeline = Pipeline(PipelineConfig(model=model, grasp=LiveGeoGraspConfig()))
    _, received = play(graph, folder, model)
    items = list(open_source(folder, frame_id="camera_depth_optical_frame"))
    assert len(received) == len(items) == 50
    for message, item in zip(received[:10], items[:10], strict=True):
        assert_same(message, item.cloud, pipeline.run_object(item.cloud))


def test_a_recording_written_again_is_the_same(recording, tmp_path):
    write_bag(tmp_path / "again", scene_clouds(SCENES))
    for one, other in zip(read_bag(recording), read_bag(tmp_path / "again"), strict=True):
        np.testing.assert_array_equal(one.xyz, other.xyz)
        assert one.stamp_ns == other.stamp_ns


def write_foreign(path: Path, clouds: Sequence[Cloud]) -> None:
    """As others do: SQLite, big-endian, z before y before x, bytes between points and rows."""
    record = np.dtype({"names": ["z", "y", "x"], "formats": [">f4"] * 3, "offsets": [0, 4, 12], "itemsize": 20})
    with Writer(path, version=8, storage_plugin=StoragePlugin.SQLITE3) as writer:
        connection = writer.add_connection("/camera/camera/depth/color/points", POINT_CLOUD_TYPE, typestore=STORE)
        for cloud in clouds:
            height, width, _ = cloud.xyz.shape
            points = np.zeros((height, width), record)
            for axis, name in enumerate("xyz"):
                points[name] = cloud.xyz[..., axis]
            rows = np.full((height, 20 * width + 24), 0xCD, np.uint8)
            rows[:, : 20 * width] = points.view(np.uint8).reshape(height, -1)
            message = STORE.deserialize_cdr(serialize_cloud(cloud), POINT_CLOUD_TYPE)
            field = STORE.types["sensor_msgs/msg/PointField"]
            message.fields = [field("z", 0, 7, 1), field("y", 4, 7, 1), field("x", 12, 7, 1)]
            message.is_bigendian = True
            message.point_step, message.row_step = 20, 20 * width + 24
            message.data = rows.reshape(-1)
            writer.write(connection, cloud.stamp_ns, STORE.serialize_cdr(message, POINT_CLOUD_TYPE))


def with_wrong_width(cloud: Cloud, stamp: int) -> bytes:
    """A message whose sizes do not add up."""
    message = STORE.deserialize_cdr(serialize_cloud(Cloud(cloud.xyz, None, "lens", stamp)), POINT_CLOUD_TYPE)
    message.width += 1
    return bytes(STORE.serialize_cdr(message, POINT_CLOUD_TYPE))
