# SPDX-License-Identifier: Apache-2.0
"""Recorder and simulated hand over real DDS: every sample against the simulator, and against its imported topics."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from sensor_msgs.msg import PointCloud2
from sim_builders import SPONGE, run, scene

from foretouch.dataset.bag import Recording
from foretouch.dataset.bag_writer import BagWriter
from foretouch.dataset.importing import BagTopics, import_samples
from foretouch.dataset.recording import SAMPLE_TOPIC, RecordedDataset
from foretouch.dataset.recording.definitions import Definitions
from foretouch.pipeline import FoundObject
from foretouch.ros.messages.clouds import objects_to_msg
from foretouch.ros.messages.conversions import grasp_to_msg, header_to_msg
from foretouch.simulation.world import CAMERA_FRAME
from foretouch.types import ASSUMED_TABLE, Cloud
from foretouch_msgs.msg import GraspArray

pytestmark = pytest.mark.ros

SECOND = 1_000_000_000
COURSE = {"course__rest_s": 0.4, "course__approach_s": 0.1, "course__close_s": 0.1, "course__hold_s": 0.4}
FAULTS = {"faults__jitter_s": 0.02, "faults__skew_s": 0.05, "faults__drop_share": 0.05}


def raw_topics(session: Path, out: Path) -> Path:
    """The messages of a session without the samples that were made of them."""
    with Recording(session) as bag, BagWriter(out) as writer:
        raw = {topic.name: topic.type for topic in bag.topics if topic.name != SAMPLE_TOPIC}
        for kind in set(raw.values()):
            if kind.startswith("foretouch_msgs"):
                writer.define(kind, Definitions().text(kind))
        for message in bag.messages(raw):
            writer.write(message.topic, message.type, message.bag_time_ns, message.data)
    return out


def labelled(path: Path) -> dict[str, Any]:
    """Samples with a touch, by their grasp."""
    with RecordedDataset(path) as dataset:
        records = [dataset[k].record for k in range(len(dataset))]
    return {one.sample.grasp.id: one for one in records if one.sample.touch is not None}


def assert_bit_equal(one: Any, other: Any) -> None:
    a, b = one.sample, other.sample
    arrays = [
        (a.cloud.xyz, b.cloud.xyz),
        *((getattr(a.grasp, name), getattr(b.grasp, name)) for name in ("g1", "g2", "rotation")),
        (a.touch.vector(), b.touch.vector()),
        (a.tare.vector(), b.tare.vector()),
        *((getattr(one.series, name), getattr(other.series, name)) for name in ("stamps_ns", "counts", "phases")),
    ]
    for left, right in arrays:
        assert left.dtype == right.dtype
        assert left.tobytes() == right.tobytes()
    for name in ("flags", "outcome", "contact_ns", "detector", "pairing_error_ns"):
        assert getattr(one, name) == getattr(other, name), name
    assert (a.object, a.stamp_ns, dict(a.extra), a.cloud.stamp_ns) == (
        b.object,
        b.stamp_ns,
        dict(b.extra),
        b.cloud.stamp_ns,
    )
    assert [grasp.id for grasp in one.candidates] == [grasp.id for grasp in other.candidates]


def test_jitter_skew_and_drops_make_no_wrong_pair(graph: Any, tmp_path: Path) -> None:
    config = scene(SPONGE | {"size_spread": 0.3})
    path = tmp_path / "scene.yaml"
    path.write_text(json.dumps(config.to_mapping()), encoding="utf-8")
    origin, slots = time.time_ns() - 1000 * SECOND, range(3, 8)
    missing = 5
    show = {"scene__path": str(path), "scene__samples": 100, "scene__origin_ns": origin, "scene__dwell_s": 10.0}
    (recorder,) = graph.add("recorder", record=str(tmp_path / "set"), object="sponge", pairing__wait_s=1.0)
    graph.add("hand", **show, **COURSE, **FAULTS)
    clouds, grasps = graph.talk(PointCloud2, "object_cloud"), graph.talk(GraspArray, "grasps")
    graph.matched("object_cloud")
    graph.matched("grasps", subscribers=2)
    graph.matched("/rh/tactile")
    time.sleep(0.5)  # of rest, for the first tare
    points, touches = {}, {}
    for done, slot in enumerate(slots):
        stamp = origin + round((10 * slot + 3) * SECOND)
        state = run(config, "grasp", "touch", slot=slot)
        points[f"slot {slot}"], touches[f"slot {slot}"] = np.full((50, 3), slot, np.float32), state.touch.vector()
        cloud = Cloud(points[f"slot {slot}"], None, CAMERA_FRAME)
        if slot == missing:  # a grasp that the recorder has to reject
            points.pop(f"slot {slot}")
        else:
            clouds.publish(objects_to_msg([FoundObject("0", cloud, ASSUMED_TABLE)], CAMERA_FRAME, stamp))
        message = grasp_to_msg(state.grasp)
        message.id, message.object_id = f"slot {slot}", "0"
        grasps.publish(GraspArray(header=header_to_msg(CAMERA_FRAME, stamp), grasps=[message]))
        graph.until(lambda done=done: sum(recorder.status().outcome_counts) == done + 1)
    status = recorder.status()
    recorder.end()
    outcomes = dict(zip(status.outcomes, status.outcome_counts, strict=True))
    assert set(outcomes) <= {"recorded", "pairing_error", "cloud_unknown"}, outcomes
    assert outcomes["cloud_unknown"] == 1
    assert outcomes["recorded"] >= 2
    with RecordedDataset(tmp_path / "set") as dataset:
        records = [dataset[k].record for k in range(len(dataset)) if dataset[k].record.sample.touch is not None]
    assert len(records) == outcomes["recorded"]
    assert len({touch.tobytes() for touch in touches.values()}) == len(touches)
    for record in records:
        name = record.sample.grasp.id
        # Without noise, the median of the hold is the touch of the simulator to the last count.
        np.testing.assert_array_equal(record.sample.touch.vector(), touches[name])
        np.testing.assert_array_equal(record.sample.cloud.xyz, points[name])
        assert 0 < record.pairing_error_ns <= SECOND // 10

    raw = raw_topics(tmp_path / "set" / "session-0001.mcap", tmp_path / "raw")
    result = import_samples(raw, tmp_path / "again", topics=BagTopics(object="sponge"))
    recorded, imported = labelled(tmp_path / "set"), labelled(tmp_path / "again")
    assert recorded.keys() == imported.keys()
    for name, record in recorded.items():
        assert_bit_equal(record, imported[name])
    rejected = {name: count for name, count in outcomes.items() if name != "recorded"}
    assert {name: result.left_out[name] for name in rejected} == rejected
