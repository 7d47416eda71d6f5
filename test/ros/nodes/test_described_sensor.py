# SPDX-License-Identifier: Apache-2.0
"""XELA's sensor on two fingers over real DDS, as its server publishes it: from its messages to a store, and the check before."""

import argparse
import io
import json
import threading
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from answer_builders import touch_message
from calibrated_models import make_calibration
from constant_models import constant_model
from message_package import use_package
from pair_builders import REST
from rich.console import Console
from robot_builders import FRAME, MS, QUICK, Robot
from sensor_builders import XELA_TYPES, sens_stream, xela_counts
from sensor_msgs.msg import PointCloud2
from sim_builders import CAN, SHORT, run, scene

from foretouch.cli import check
from foretouch.cli.record import record_panel
from foretouch.dataset.info import describe
from foretouch.dataset.recording.verify import verify_dataset
from foretouch.dataset.samples import open_samples
from foretouch.dataset.store import Store
from foretouch.dataset.topics import CLOUD_TOPIC
from foretouch.ros.messages.clouds import cloud_to_msg
from foretouch.ros.messages.conversions import grasp_to_msg, header_to_msg
from foretouch.tactile.description import packaged_sensor
from foretouch.tactile.messages.table import stamp_ns
from foretouch.types import Touch, TouchPrediction
from foretouch_lab.dataset.store_writer import build_store
from foretouch_lab.simulation.world import CAMERA_FRAME
from foretouch_msgs.msg import Grasp, GraspArray, TouchPredictionArray

pytestmark = [
    pytest.mark.ros,
    pytest.mark.slow,
    pytest.mark.timeout(600),
]  # it builds the package of the messages, once

SENSOR = {"tactile__sensor": "xela_uskin_4x4"}
HAND = "/rh/tactile"


class UskinHand(Robot):
    """Both fingers press by the level that the counts of a BioTac have; `now` is the server's clock."""

    pressed = 0
    fingers: tuple[int, ...] = (0, 1)  # that press
    taxels = 16

    def __init__(self, graph: Any) -> None:
        from xela_server_ros2.msg import SensorFull, SensStream, Taxel

        self.kinds = {"Taxel": Taxel, "SensorFull": SensorFull, "SensStream": SensStream}
        self.tactile = SensStream
        super().__init__(graph)
        self.predicted = graph.talk_matched(TouchPredictionArray, "touch")

    def see(self, name: str) -> None:
        """Its cloud and grasps, and what is predicted for them."""
        super().see(name)
        sensor, header = packaged_sensor("xela_uskin_4x4"), header_to_msg(FRAME, self.now)
        touch = Touch(xela_counts(100).transpose(2, 0, 1).ravel().astype(np.float64), sensor.channels)
        one = touch_message(TouchPrediction(None, touch, touch, touch), Grasp(id=name), header, sensor=sensor)
        self.predicted.publish(TouchPredictionArray(header=header, predictions=[one]))
        self.sent["touch"] = self.sent.get("touch", 0) + 1

    def feel(self, counts: np.ndarray, readings: int) -> None:
        self.pressed = round(counts[0] - REST[0])
        for _ in range(readings):
            self.publish()
            self.now += 10 * MS
            time.sleep(0.001)

    def publish(self) -> None:
        rest, found = xela_counts(0), xela_counts(self.pressed)
        found = np.where(np.isin(np.arange(2), self.fingers)[:, None, None], found, rest)
        noisy = np.round(found + self._rng.normal(0.0, 4.0, found.shape))[:, : self.taxels]
        self.hand.publish(sens_stream(noisy, (1, 2), self.now * 1e-9, self.kinds))
        self.sent[HAND] += 1


@pytest.fixture
def xela(monkeypatch: pytest.MonkeyPatch) -> None:
    use_package(XELA_TYPES, monkeypatch)


@pytest.mark.usefixtures("xela")
def test_its_grasps_are_recorded_and_built_to_a_store(graph: Any, tmp_path: Path) -> None:
    (node,) = graph.add("recorder", record=str(tmp_path / "set"), folder=str(tmp_path), object="can", **QUICK, **SENSOR)
    assert node.state_name == "active"
    hand = UskinHand(graph)
    for number in range(2):
        hand.grasp(f"g-{number}", number)
        graph.until(lambda wanted=number + 1: node.status().samples == wanted)
    hand.taxels = 8  # as of another sensor
    hand.publish()
    graph.until(lambda: node.notes().get(f"tactile.unreadable {HAND}") == "1")
    graph.until(lambda: sum(topic.received for topic in node.status().topics) == sum(hand.sent.values()))
    status = node.status()
    assert dict(zip(status.sensors, status.sensor_states, strict=True)) == dict.fromkeys(
        ("TH", "FF", "camera"), "alive"
    )
    assert status.topics[4].topic == "/foretouch/touch"
    shown = Console(width=200, record=True, file=io.StringIO())
    shown.print(record_panel(status, "title", node.session_status(), sensor=node.reader.sensor))
    text = shown.export_text()
    assert f"not usable: 1 unreadable {HAND}" in text
    assert "predicted" in text
    assert "30120–30570 ±0" in text  # Z_TH as predicted
    node.end()
    graph.remove(node)
    (report,) = verify_dataset(tmp_path / "set")
    assert not report.faults
    samples = open_samples(tmp_path / "set")
    assert (samples.sensor.sha256, samples.identity.hand["tactile"]) == (
        packaged_sensor("xela_uskin_4x4").sha256,
        "xela_server_ros2/SensStream",
    )
    for number, one in enumerate(samples.records()):
        expected = xela_counts(100 + 20 * number).transpose(2, 0, 1).ravel()
        np.testing.assert_allclose(one.sample.touch.values, expected, atol=5.0)
        np.testing.assert_allclose(one.sample.tare.values, xela_counts(0).transpose(2, 0, 1).ravel(), atol=5.0)
        assert (one.outcome, one.flags, one.series.counts.shape[1]) == ("success", (), 96)
        assert abs(one.contact_ns - one.sample.stamp_ns) < 1000  # the server's time is a number of 64 bits [s]
    build_store([tmp_path / "set"], tmp_path / "store")
    assert Store(tmp_path / "store").sensor.sha256 == samples.sensor.sha256
    assert describe(tmp_path / "store").units["Z_TH"] == "counts"
    (other,) = graph.add("recorder", folder=str(tmp_path), tactile_topic="/other")
    with pytest.raises(Exception, match=r"sensor: xela_uskin_4x4 \(\w+\) there, biotac_sp \(\w+\) here"):
        other.begin(str(tmp_path / "set"))


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
    monkeypatch.setattr("foretouch.ros.touch.predictor.load_model", lambda _: model)
    monkeypatch.setattr("foretouch.ros.touch.history_keeper.HistoryKeeper.changed", lambda _: None)
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
        assert not any("unreadable" in key and value != "0" for key, value in node.notes().items())
    recorder.end()
    (one,) = open_samples(tmp_path / "set").records()
    np.testing.assert_allclose(one.sample.touch.values, sample.touch.values, atol=400.0)  # noise and slow changes
    assert predictor.notes()["tare_age_s"] != "none"


@pytest.mark.usefixtures("xela")
def test_it_is_checked_before_a_session(graph: Any, tmp_path: Path, monkeypatch: Any, capsys: Any) -> None:
    monkeypatch.setattr(check, "_REST_S", 3.0)
    (node,) = graph.add("recorder", **SENSOR)
    hand, ended = UskinHand(graph), threading.Event()

    def publish() -> None:
        while not ended.wait(0.01):
            hand.now = time.time_ns()
            hand.publish()

    def press(text: str) -> None:
        if "press the" in text:
            hand.fingers, hand.pressed = (0 if "(TH)" in text else 1,), 300
            threading.Timer(1.0, lambda: setattr(hand, "pressed", 0)).start()

    monkeypatch.setattr(check, "warn", press)
    thread = threading.Thread(target=publish)
    thread.start()
    try:
        check.run_check(node, argparse.Namespace(output=str(tmp_path / "set"), json=False))
    finally:
        ended.set()
        thread.join()
    found = capsys.readouterr().out
    for line in (
        "ok    thumb: alive",
        "ok    FF: alive",
        "ok    press thumb: TH answered",
        "ok    press FF: FF answered",
    ):
        assert line in found, found
    assert "at least 50 are needed" not in found
    assert "temperature" not in found
