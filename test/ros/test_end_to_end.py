# SPDX-License-Identifier: Apache-2.0
"""Recordings through the whole graph over real DDS: one answer a cloud, equal to the pipeline's own."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from foretouch.cloud.io.files import write_cloud
from foretouch.dataset.bag import POINT_CLOUD_TYPE, Recording
from foretouch.dataset.bag_writer import BagWriter, serialize_cloud, write_bag
from foretouch.dataset.source import STAMP_STEP_NS, open_source
from foretouch.grasp import LiveGeoGraspConfig
from foretouch.pipeline import Pipeline, PipelineConfig
from foretouch.tactile.messages.table import stamp_ns
from foretouch.types import ASSUMED_TABLE, Cloud, Plane
from foretouch_msgs.msg import Status, TouchPredictionArray

pytestmark = pytest.mark.ros

LISTENER = Path(__file__).parents[2] / "examples" / "listen_touch.py"
STORE = get_typestore(Stores.ROS2_KILTED)
FRAME = "camera_depth_optical_frame"


@pytest.fixture(scope="module")
def clouds(scene_cloud):
    return [scene_cloud(seed, stamp_ns=1_700_000_000_000_000_000 + seed * STAMP_STEP_NS) for seed in range(6)]


@pytest.fixture(scope="module")
def pipeline(model_card):
    return Pipeline(PipelineConfig(model=model_card, grasp=LiveGeoGraspConfig()))


def play(graph, path, model, **parameters):
    """The answers of the three nodes to a replay, when it has ended."""
    received = graph.listen(TouchPredictionArray, "touch")
    graph.add("segmentation")
    graph.add("grasp", grasp_hold=0.0)  # so that each cloud is answered as it would be alone
    graph.add("touch_predictor", model=model)
    options = {"lockstep": True, "rate_hz": 1000.0, "discovery_s": 0.0, **parameters}
    (replay,) = graph.add("replay", path=str(path), **options)
    assert replay.ended.wait(60.0)
    assert (replay.outcome, replay.unanswered) == ("finished", 0)
    graph.until(lambda: len(received) >= replay.played[replay.clouds_topic])
    return received


def assert_same(message, cloud, result):
    """Stamp and frame are the cloud's; contacts, rotation and all 50 values are those of the pipeline, bit for bit."""
    expected = [one for felt in result.targets for one in felt.predictions]
    assert (stamp_ns(message.header.stamp), message.header.frame_id) == (cloud.stamp_ns, cloud.frame_id)
    assert len(message.predictions) == len(expected)
    for got, wanted in zip(message.predictions, expected, strict=True):
        assert got.header == message.header
        for name in ("g1", "g2"):
            point = getattr(got.grasp, name)
            assert [point.x, point.y, point.z] == getattr(wanted.grasp, name).tolist()
        assert got.grasp.rotation.tolist() == wanted.grasp.rotation.reshape(9).tolist()
        values = [one.value for one in (got.pdc_th, got.pdc_mf, *got.e_th, *got.e_mf)]
        np.testing.assert_array_equal(np.array(values, np.float32), wanted.value.vector().astype(np.float32))


def test_a_recording_gets_one_answer_a_cloud_equal_to_the_pipeline_in_another_process_too(
    lone_graph, tmp_path, clouds, pipeline, model_card
):
    write_bag(tmp_path / "bag", clouds)
    command = [sys.executable, str(LISTENER), "--count", str(len(clouds))]  # a program with nothing but rclpy
    listener = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=lone_graph.environment())
    try:
        lone_graph.until(lambda: lone_graph.probe.count_subscribers("/foretouch/touch") > 0)
        received = play(lone_graph, tmp_path / "bag", model_card)
        printed, _ = listener.communicate(timeout=30.0)
    finally:
        listener.kill()
    results = [pipeline.run(cloud) for cloud in clouds]
    assert all(result.targets for result in results)
    for message, cloud, result in zip(received, clouds, results, strict=True):
        assert_same(message, cloud, result)
    heard = list(dict.fromkeys(line.split(":")[0] for line in printed.splitlines()))
    stamps = [divmod(cloud.stamp_ns, 10**9) for cloud in clouds]
    assert heard == [f"{sec}.{ns:09d} {FRAME}" for sec, ns in stamps]
    assert "thumb PDC" in printed


def test_at_the_pace_of_the_recording_nothing_is_lost(graph, tmp_path, clouds, model_card):
    write_bag(tmp_path / "bag", clouds)
    received = play(graph, tmp_path / "bag", model_card, lockstep=False, rate_hz=5.0)
    assert [stamp_ns(message.header.stamp) for message in received] == [cloud.stamp_ns for cloud in clouds]


def test_a_bag_of_others_gets_the_same_touch(graph, tmp_path, clouds, pipeline, model_card):
    write_foreign(tmp_path / "foreign", clouds)
    with Recording(tmp_path / "foreign") as foreign:
        assert foreign.content(next(foreign.messages())).is_bigendian
    received = play(graph, tmp_path / "foreign", model_card)
    for message, cloud in zip(received, clouds, strict=True):
        assert_same(message, cloud, pipeline.run(cloud))


def test_a_folder_of_objects_gets_one_answer_a_file_behind_the_segmentation(
    graph, tmp_path, clouds, pipeline, model_card
):
    scene = pipeline.segment(clouds[0]).segmentation
    for number, segment in enumerate(scene.objects):
        write_cloud(tmp_path / f"object{number}.npz", segment.cloud)
    coefficients = scene.plane.coefficients
    received = play(graph, tmp_path, model_card, table=coefficients.tolist())
    items = list(open_source(tmp_path, frame_id=FRAME))
    assert len(items) == 2
    for number, (message, item) in enumerate(zip(received, items, strict=True), 1):
        assert item.cloud.stamp_ns == number * STAMP_STEP_NS
        assert_same(message, item.cloud, pipeline.run(item.cloud, Plane.from_coefficients(coefficients)))


def test_clouds_without_an_object_are_answered_with_the_reason(graph, tmp_path, clouds, model_card):
    xyz = clouds[0].xyz
    wrong = STORE.deserialize_cdr(serialize_cloud(Cloud(xyz, None, "lens", 4)), POINT_CLOUD_TYPE)
    wrong.width += 1
    with BagWriter(tmp_path / "bag") as writer:
        writer.write_cloud(Cloud(np.empty((0, 3), np.float32), None, "lens", 1))
        writer.write_cloud(Cloud(np.full_like(xyz, np.nan), None, "lens", 2))
        writer.write_cloud(Cloud(xyz, None, "", 3))
        writer.write("/foretouch/points", POINT_CLOUD_TYPE, 4, bytes(STORE.serialize_cdr(wrong, POINT_CLOUD_TYPE)))
        writer.write_cloud(Cloud(xyz, None, "lens", 5))
    received = play(graph, tmp_path / "bag", model_card)
    assert [stamp_ns(message.header.stamp) for message in received] == [1, 2, 3, 4, 5]
    statuses = [Status.EMPTY_CLOUD, Status.EMPTY_CLOUD, Status.UNKNOWN_FRAME, Status.BAD_CLOUD]
    assert [message.status for message in received[:4]] == statuses
    assert all(message.reason and not message.predictions for message in received[:4])
    assert received[4].predictions


@pytest.mark.real_data
@pytest.mark.slow
def test_real_samples_get_one_answer_each_equal_to_the_pipeline(graph, real_data, pipeline, model_card):
    folder = real_data / "vision2tactile" / "rugby"
    received = play(graph, folder, model_card)
    items = list(open_source(folder, frame_id=FRAME))
    assert len(received) == len(items) == 50
    for message, item in zip(received[:10], items[:10], strict=True):
        assert_same(message, item.cloud, pipeline.run(item.cloud, ASSUMED_TABLE))


def write_foreign(path, clouds):
    """As others do: SQLite, big-endian, z before y before x, bytes between points and rows."""
    record = np.dtype({"names": ["z", "y", "x"], "formats": [">f4"] * 3, "offsets": [0, 4, 12], "itemsize": 20})
    field = STORE.types["sensor_msgs/msg/PointField"]
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
            message.fields = [field("z", 0, 7, 1), field("y", 4, 7, 1), field("x", 12, 7, 1)]
            message.is_bigendian, message.data = True, rows.reshape(-1)
            message.point_step, message.row_step = 20, 20 * width + 24
            writer.write(connection, cloud.stamp_ns, STORE.serialize_cdr(message, POINT_CLOUD_TYPE))
