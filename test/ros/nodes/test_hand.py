# SPDX-License-Identifier: Apache-2.0
"""The simulated hand over real DDS: what it sends, when, and what it reports."""

import json
import time
import weakref

import numpy as np
import pytest
from sim_builders import SHORT, SPONGE, run, scene
from std_srvs.srv import Trigger

from foretouch.ros.messages.conversions import grasp_to_msg, header_to_msg
from foretouch.tactile.messages.biotac import FINGER_ORDER, finger_counts
from foretouch.types import Grasp, stamp_ns
from foretouch_lab.simulation.world import CAMERA_FRAME
from foretouch_msgs.msg import BiotacAll, ExecutedGrasp, GraspArray

pytestmark = pytest.mark.ros

SECOND = 1_000_000_000


@pytest.fixture
def start(graph, tmp_path):
    """Starts the hand on a scene: the node, its tactile messages, its reports, and a function that sends it a grasp."""

    def run_node(config=None, **parameters):
        path = tmp_path / "scene.yaml"
        path.write_text(json.dumps((config or scene()).to_mapping()), encoding="utf-8")  # JSON is YAML
        tactile, reports = graph.listen(BiotacAll, "/rh/tactile"), graph.listen(ExecutedGrasp, "executed_grasp")
        (node,) = graph.add("hand", **{"scene__path": str(path), "scene__samples": 1, **SHORT, **parameters})
        assert node.state_name == "active"
        publisher = graph.talk_matched(GraspArray, "grasps")

        def send(name, grasp=None, nanoseconds=None, frame=CAMERA_FRAME):
            message = grasp_to_msg(grasp or planned(config or scene()))
            message.id = name
            header = header_to_msg(frame, nanoseconds or time.time_ns())
            publisher.publish(GraspArray(header=header, grasps=[message]))

        return node, tactile, reports, send

    return run_node


def planned(config, slot=0):
    return run(config, "grasp", slot=slot).grasp


def between(messages, low, high):
    """Those stamped in [low, high)."""
    return [m for m in messages if low <= stamp_ns(m.header.stamp) < high]


def test_a_grasp_is_felt_when_and_as_strongly_as_the_hand_reports(graph, start):
    config = scene(SPONGE)
    node, tactile, reports, send = start(config)
    send("g-1")
    graph.until(lambda: reports)
    begun, contact, release = (stamp_ns(t) for t in (reports[0].start, reports[0].contact, reports[0].release))
    assert (reports[0].grasp_id, reports[0].success, reports[0].header.frame_id) == ("g-1", True, CAMERA_FRAME)
    assert release - contact == round(0.2 * SECOND)
    graph.until(lambda: stamp_ns(tactile[-1].header.stamp) >= release)
    sample = run(config)
    for low, high, touch in ((begun - SECOND // 5, begun, sample.tare), (contact, release, sample.touch)):
        messages = between(tactile, low, high)
        assert len(messages) == 20
        for message in messages:
            np.testing.assert_array_equal(finger_counts(message, "TH"), [touch["PDC_TH"][0], *touch["E_TH"]])
            np.testing.assert_array_equal(finger_counts(message, "MF"), [touch["PDC_MF"][0], *touch["E_MF"]])
    assert (node.statistics.summary().used, node.reported().values["executed.success"]) == (1, "1")


def test_messages_come_at_100_hz_with_even_stamps_noise_and_zeros_where_there_is_no_sensor(graph, start):
    node, tactile, *_ = start(scene(fingers={"noise": {}}))
    graph.until(lambda: len(tactile) >= 100)
    messages = tactile[:100]
    assert set(np.diff([stamp_ns(m.header.stamp) for m in messages])) == {SECOND // 100}
    assert messages[0].header.frame_id == "rh_tactile"
    counts = {finger: np.array([finger_counts(m, finger) for m in messages]) for finger in FINGER_ORDER}
    for finger, found in counts.items():
        assert found.shape == (100, 25)
        assert (found > 0).all() if finger in {"MF", "TH"} else not found.any()
    assert (counts["TH"] != counts["MF"]).mean() > 0.5  # each has noise of its own
    assert node.phase == "idle"


def test_a_grasp_beside_the_object_fails_and_one_in_another_frame_is_refused(graph, start):
    node, tactile, reports, send = start()
    send("elsewhere", frame="map")
    graph.until(lambda: node.statistics.summary().dropped)
    assert (dict(node.statistics.summary().dropped), reports) == ({"refused": 1}, [])
    grasp, aside = planned(scene()), np.array([0.3, 0.0, 0.0])
    send("beside", Grasp(grasp.g1 + aside, grasp.g2 + aside, grasp.rotation))
    graph.until(lambda: reports)
    (report,) = reports
    assert (report.success, stamp_ns(report.contact), stamp_ns(report.release)) == (False, 0, 0)
    assert stamp_ns(report.start) > 0
    assert dict(node.statistics.summary().dropped) == {"refused": 1, "misses": 1}
    assert len({tuple(finger_counts(m, "TH")) for m in tactile}) == 1


def test_on_request_only(graph, start):
    node, _, reports, send = start(automatic=False)
    execute = lambda: graph.call(Trigger, "execute_grasp")  # noqa: E731
    assert execute().message == "there is no grasp"
    send("asked for")
    graph.until(lambda: node._newest is not None)
    time.sleep(0.2)
    assert node.phase == "idle"
    answers = [execute() for _ in range(2)]
    assert [(answer.success, answer.message) for answer in answers] == [
        (True, "asked for"),
        (False, "the hand is busy"),
    ]
    graph.until(lambda: reports)
    assert execute().message == "there is no new grasp"


def test_a_grasp_that_is_stopped_is_not_reported_and_cleaning_up_releases_the_scene(graph, start):
    node, _, reports, send = start()
    send("broken off")
    graph.until(lambda: node.phase == "hold")
    node.trigger_deactivate()
    assert (node.phase, dict(node.statistics.summary().dropped)) == ("idle", {"stopped": 1})
    node.trigger_activate()
    send("whole")
    graph.until(lambda: reports)
    assert [report.grasp_id for report in reports] == ["whole"]
    released = weakref.ref(node._hand)
    node.trigger_deactivate()
    node.trigger_cleanup()
    assert released() is None
