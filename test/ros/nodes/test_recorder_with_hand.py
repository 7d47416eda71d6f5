# SPDX-License-Identifier: Apache-2.0
"""Recorder and simulated hand over real DDS: every sample against the simulator."""

import json
import time

import numpy as np
import pytest
from sensor_msgs.msg import PointCloud2
from sim_builders import SPONGE, run, scene

from foretouch.dataset.recording import RecordedDataset
from foretouch.pipeline import FoundObject
from foretouch.ros.messages.clouds import objects_to_msg
from foretouch.ros.messages.conversions import grasp_to_msg, header_to_msg
from foretouch.simulation.world import CAMERA_FRAME
from foretouch.types import ASSUMED_TABLE, Cloud
from foretouch_msgs.msg import GraspArray

pytestmark = [pytest.mark.ros, pytest.mark.slow]

SECOND = 1_000_000_000
COURSE = {"course__rest_s": 0.4, "course__approach_s": 0.1, "course__close_s": 0.1, "course__hold_s": 0.4}
FAULTS = {"faults__jitter_s": 0.02, "faults__skew_s": 0.05, "faults__drop_share": 0.05}
NOT_RECORDED = 5


def labelled(path):
    """Samples with a touch, by their grasp."""
    dataset = RecordedDataset(path)
    records = [dataset[k].record for k in range(len(dataset))]
    return {one.sample.grasp.id: one for one in records if one.sample.touch is not None}


def test_jitter_skew_and_drops_make_no_wrong_pair(graph, tmp_path):
    config, path = scene(SPONGE | {"size_spread": 0.3}), tmp_path / "scene.yaml"
    path.write_text(json.dumps(config.to_mapping()), encoding="utf-8")
    origin, slots = time.time_ns() - 1000 * SECOND, range(3, 8)
    show = {"scene__path": str(path), "scene__samples": 100, "scene__origin_ns": origin, "scene__dwell_s": 10.0}
    (recorder,) = graph.add("recorder", record=str(tmp_path / "set"), object="sponge", pairing__wait_s=1.0)
    graph.add("hand", **show, **COURSE, **FAULTS)
    clouds, grasps = graph.talk(PointCloud2, "object_cloud"), graph.talk(GraspArray, "grasps")
    graph.matched("object_cloud", "/rh/tactile")
    graph.matched("grasps", subscribers=2)
    time.sleep(0.5)  # of rest, for the first tare
    touches = {}
    for done, slot in enumerate(slots):
        stamp, state = origin + round((10 * slot + 3) * SECOND), run(config, "grasp", "touch", slot=slot)
        touches[f"slot {slot}"] = state.touch.vector()
        cloud = Cloud(np.full((50, 3), slot, np.float32), None, CAMERA_FRAME)
        if slot != NOT_RECORDED:  # else the recorder has to reject the grasp
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
    recorded = labelled(tmp_path / "set")
    assert len(recorded) == outcomes["recorded"]
    assert len({touch.tobytes() for touch in touches.values()}) == len(touches)
    for name, record in recorded.items():
        # Without noise, the median of the hold is the touch of the simulator to the last count.
        np.testing.assert_array_equal(record.sample.touch.vector(), touches[name])
        assert set(record.sample.cloud.xyz.ravel()) == {float(name.removeprefix("slot "))}
        assert 0 < record.pairing_error_ns <= SECOND // 10
