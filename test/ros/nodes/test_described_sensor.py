# SPDX-License-Identifier: Apache-2.0
"""The simulated hand with XELA's sensor over real DDS: predicted, adapted to and recorded."""

import json
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from calibrated_models import make_calibration
from constant_models import constant_model
from message_package import use_package
from robot_builders import QUICK
from sensor_builders import XELA_TYPES
from sensor_msgs.msg import PointCloud2
from sim_builders import CAN, SHORT, run, scene

from foretouch.dataset.formats import open_samples
from foretouch.ros.messages.clouds import cloud_to_msg
from foretouch.ros.messages.conversions import grasp_to_msg, header_to_msg
from foretouch.tactile.description import packaged_sensor
from foretouch.topics import CLOUD_TOPIC
from foretouch.types import stamp_ns
from foretouch_lab.simulation.world import CAMERA_FRAME
from foretouch_msgs.msg import GraspArray

pytestmark = [
    pytest.mark.ros,
    pytest.mark.slow,
    pytest.mark.timeout(600),
]  # it builds the package of the messages, once

SENSOR = {"tactile__sensor": "xela_uskin_4x4"}
HAND = "/rh/tactile"


@pytest.fixture
def xela(monkeypatch: pytest.MonkeyPatch) -> None:
    use_package(XELA_TYPES, monkeypatch)


@pytest.mark.usefixtures("xela")
def test_the_simulated_hand_sends_it_the_predictor_adapts_to_it_and_its_grasps_are_recorded(
    graph: Any, tmp_path: Path, monkeypatch: Any
) -> None:
    from xela_server_ros2.msg import SensStream

    config = scene(CAN, fingers={"sensor": "xela_uskin_4x4", "noise": {}})
    path = tmp_path / "scene.yaml"
    path.write_text(json.dumps(config.to_mapping()), encoding="utf-8")
    sensor = packaged_sensor("xela_uskin_4x4")
    rest = run(config).tare.values
    model = constant_model(sensor, rest, make_calibration(0, sensor.channels, rest))
    monkeypatch.setattr("foretouch.ros.steps.predictor.load_model", lambda *_: model)
    monkeypatch.setattr("foretouch.models.history_keeper.HistoryKeeper.changed", lambda _: None)
    messages = graph.listen(SensStream, HAND)
    (hand,) = graph.add("hand", scene__path=str(path), scene__samples=1, **SHORT)
    (recorder,) = graph.add(
        "recorder", record=str(tmp_path / "set"), folder=str(tmp_path), object="can", **QUICK, **SENSOR
    )
    (predictor,) = graph.add("touch_predictor", **SENSOR, **QUICK)
    publishers = [graph.talk_matched(kind, name) for kind, name in ((PointCloud2, CLOUD_TOPIC), (GraspArray, "grasps"))]
    graph.until(lambda: len(messages) > 50)
    sample = run(config)
    header = header_to_msg(CAMERA_FRAME, time.time_ns())
    grasp = grasp_to_msg(sample.grasp)
    grasp.id = "g-1"
    cloud = cloud_to_msg(replace(sample.cloud, frame_id=CAMERA_FRAME, stamp_ns=stamp_ns(header.stamp)))
    for publisher, message in zip(publishers, (cloud, GraspArray(header=header, grasps=[grasp])), strict=True):
        publisher.publish(message)
    graph.until(lambda: hand.executed["success"] == 1)
    graph.until(lambda: recorder.status().samples == 1)
    for node in (recorder, predictor):
        assert not any("unreadable" in key and value != "0" for key, value in node.reported().values.items())
    recorder.end()
    (one,) = open_samples(tmp_path / "set")
    np.testing.assert_allclose(one.touch.values, sample.touch.values, atol=400.0)  # noise and slow changes
    assert predictor.reported().values["tare_age_s"] != "none"
