# SPDX-License-Identifier: Apache-2.0
"""Recordings through the whole graph over real DDS: one answer a cloud, equal to the pipeline's own."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore

from foretouch.dataset.bag_writer import write_bag
from foretouch.dataset.source import STAMP_STEP_NS
from foretouch.grasp import LiveGeoGraspConfig
from foretouch.pipeline import Pipeline, PipelineConfig
from foretouch.tactile.messages.table import stamp_ns
from foretouch_msgs.msg import TouchPredictionArray

pytestmark = pytest.mark.ros

LISTENER = Path(__file__).parents[2] / "examples" / "listen_touch.py"
STORE = get_typestore(Stores.ROS2_KILTED)
FRAME = "camera_depth_optical_frame"


def assert_same(message, cloud, result):
    """Stamp and frame are the cloud's; contacts, rotation and all 50 values are those of the pipeline, bit for bit."""
    expected = [one for felt in result.targets for one in felt.predictions]
    assert (stamp_ns(message.header.stamp), message.header.frame_id) == (cloud.stamp_ns, cloud.frame_id)
    for got, wanted in zip(message.predictions, expected, strict=True):
        assert got.header == message.header
        for name in ("g1", "g2"):
            point = getattr(got.grasp, name)
            assert [point.x, point.y, point.z] == getattr(wanted.grasp, name).tolist()
        assert got.grasp.rotation.tolist() == wanted.grasp.rotation.reshape(9).tolist()
        values = [one.value for one in (got.pdc_th, got.pdc_mf, *got.e_th, *got.e_mf)]
        np.testing.assert_array_equal(np.array(values, np.float32), wanted.value.vector().astype(np.float32))


def test_a_recording_gets_one_answer_a_cloud_equal_to_the_pipeline_in_another_process_too(
    lone_graph, tmp_path, scene_cloud, model_card
):
    graph, start = lone_graph, 1_700_000_000_000_000_000
    clouds = [scene_cloud(seed, stamp_ns=start + seed * STAMP_STEP_NS) for seed in range(6)]
    write_bag(tmp_path / "bag", clouds)
    command = [sys.executable, str(LISTENER), "--count", str(len(clouds))]  # a program with nothing but rclpy
    listener = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=graph.environment())
    try:
        graph.until(lambda: graph.probe.count_subscribers("/foretouch/touch") > 0)
        received = graph.listen(TouchPredictionArray, "touch")
        graph.add("segmentation")
        graph.add("grasp", grasp_hold=0.0)  # so that each cloud is answered as it would be alone
        graph.add("touch_predictor", model=model_card)
        options = {"lockstep": True, "rate_hz": 1000.0, "discovery_s": 0.0}
        (replay,) = graph.add("replay", path=str(tmp_path / "bag"), **options)
        assert replay.ended.wait(60.0)
        assert (replay.outcome, replay.unanswered) == ("finished", 0)
        graph.until(lambda: len(received) >= len(clouds))
        printed, _ = listener.communicate(timeout=30.0)
    finally:
        listener.kill()
    pipeline = Pipeline(PipelineConfig(model=model_card, grasp=LiveGeoGraspConfig()))
    for message, cloud in zip(received, clouds, strict=True):
        result = pipeline.run(cloud)
        assert result.targets
        assert_same(message, cloud, result)
    heard = list(dict.fromkeys(line.split(":")[0] for line in printed.splitlines()))
    stamps = [divmod(cloud.stamp_ns, 10**9) for cloud in clouds]
    assert heard == [f"{sec}.{ns:09d} {FRAME}" for sec, ns in stamps]
    assert "thumb PDC" in printed
