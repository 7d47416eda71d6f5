# SPDX-License-Identifier: Apache-2.0
"""The simulated hand over real DDS: what it sends, when, and what it tells of it."""

from __future__ import annotations

import json
import time
import weakref
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.parameter import Parameter
from sim_builders import CAN, SPONGE, run, scene
from std_srvs.srv import Trigger

from foretouch.errors import ConfigError
from foretouch.ros.messages.conversions import grasp_to_msg, header_to_msg
from foretouch.ros.messages.tactile import biotac_all_to_msg
from foretouch.ros.nodes import hand
from foretouch.ros.nodes.hand import HandConfig, HandNode
from foretouch.simulation.world import CAMERA_FRAME
from foretouch.tactile.messages.biotac_all import FINGER_ORDER, finger_counts
from foretouch.tactile.messages.table import stamp_ns
from foretouch.types import Grasp
from foretouch_msgs.msg import BiotacAll, ExecutedGrasp, GraspArray

pytestmark = pytest.mark.ros

SECOND = 1_000_000_000
SHORT = {"course__rest_s": 0.2, "course__approach_s": 0.1, "course__close_s": 0.1, "course__hold_s": 0.2}


@pytest.fixture
def scene_file(tmp_path: Path) -> Callable[..., str]:
    """Writes a scene; JSON is YAML."""

    def write(config: Any) -> str:
        path = tmp_path / "scene.yaml"
        path.write_text(json.dumps(config.to_mapping()), encoding="utf-8")
        return str(path)

    return write


def planned(config: Any, slot: int = 0) -> Grasp:
    return run(config, "grasp", slot=slot).grasp


def grasps(grasp: Grasp, name: str, nanoseconds: int, frame: str = CAMERA_FRAME) -> GraspArray:
    message = grasp_to_msg(grasp)
    message.id = name
    return GraspArray(header=header_to_msg(frame, nanoseconds), grasps=[message])


def start(graph: Any, path: str, **parameters: Any) -> tuple[HandNode, list[Any], list[Any]]:
    tactile, told = graph.listen(BiotacAll, "/rh/tactile"), graph.listen(ExecutedGrasp, "executed_grasp")
    (node,) = graph.add("hand", **{"scene__path": path, "scene__samples": 1, **SHORT, **parameters})
    assert node.state_name == "active"
    return node, tactile, told


def between(messages: list[Any], low: int, high: int) -> list[Any]:
    """Those stamped in [low, high)."""
    return [m for m in messages if low <= stamp_ns(m.header.stamp) < high]


def test_a_grasp_is_felt_when_and_as_strongly_as_the_hand_says(graph, scene_file) -> None:
    config = scene(SPONGE)
    node, tactile, told = start(graph, scene_file(config))
    send = graph.talk(GraspArray, "grasps")
    graph.matched("grasps")
    send.publish(grasps(planned(config), "g-1", time.time_ns()))
    graph.until(lambda: told)
    report = told[0]
    begun, contact, release = (stamp_ns(t) for t in (report.start, report.contact, report.release))
    assert (report.grasp_id, report.success, report.header.frame_id) == ("g-1", True, CAMERA_FRAME)
    assert release - contact == round(0.2 * SECOND)
    graph.until(lambda: stamp_ns(tactile[-1].header.stamp) >= release)

    sample = run(config, "touch", "tare")
    for low, high, touch in ((begun - SECOND // 5, begun, sample.tare), (contact, release, sample.touch)):
        messages = between(tactile, low, high)
        assert len(messages) == 20
        for message in messages:
            expected = [(touch.pdc_th, touch.e_th), (touch.pdc_mf, touch.e_mf)]
            for finger, (pdc, electrodes) in zip(("TH", "MF"), expected, strict=True):
                np.testing.assert_array_equal(finger_counts(message, finger), [pdc, *electrodes])
    assert node.statistics.summary().used == 1
    assert node.notes()["executed.success"] == "1"


def test_messages_come_at_100_hz_with_even_stamps_and_zeros_where_there_is_no_sensor(graph, scene_file) -> None:
    node, tactile, _ = start(graph, scene_file(scene()))
    graph.until(lambda: len(tactile) >= 100)
    messages = tactile[:100]
    stamps = [stamp_ns(m.header.stamp) for m in messages]
    assert set(np.diff(stamps)) == {SECOND // 100}
    assert messages[0].header.frame_id == "rh_tactile"
    for finger in FINGER_ORDER:
        counts = np.array([finger_counts(m, finger) for m in messages])
        assert counts.shape == (100, 25)
        assert (counts > 0).all() if finger in {"MF", "TH"} else not counts.any()
    assert node.phase == "idle"


def test_other_fingers_may_carry_a_biotac_with_noise_of_its_own(graph, scene_file) -> None:
    config = scene(fingers={"noise": {}})
    _, tactile, _ = start(graph, scene_file(config), biotacs=["FF", "MF", "TH"])
    graph.until(lambda: len(tactile) >= 50)
    first, middle = (np.array([finger_counts(m, name) for m in tactile[:50]]) for name in ("FF", "MF"))
    assert (first > 0).all()
    assert (first != middle).mean() > 0.5


def test_jitter_skew_and_drops_are_put_in_and_counted(graph, scene_file) -> None:
    node, tactile, _ = start(
        graph, scene_file(scene()), faults__jitter_s=0.02, faults__skew_s=0.05, faults__drop_share=0.2
    )
    graph.until(lambda: len(tactile) >= 200)
    node.trigger_deactivate()
    time.sleep(0.3)
    stamps = np.array([stamp_ns(m.header.stamp) for m in tactile])
    assert (np.diff(stamps) < 0).any()
    notes = node.notes()
    assert notes["tactile.sent"] == notes["tactile.moved.injected"]
    assert 0 <= int(notes["tactile.sent"]) - len(tactile) <= 30  # those sent before we were found
    total = len(tactile) + int(notes["tactile.dropped.injected"])
    assert int(notes["tactile.dropped.injected"]) / total == pytest.approx(0.2, abs=0.13)


def test_faults_may_come_while_it_runs(graph, scene_file) -> None:
    node, tactile, _ = start(graph, scene_file(scene()))
    graph.until(lambda: tactile)
    node.set_parameters([Parameter("faults.drop_share", value=1.0)])
    graph.until(lambda: int(node.notes()["tactile.dropped.injected"]) > 10)
    heard = len(tactile)
    time.sleep(0.2)
    assert len(tactile) <= heard + 1


def test_a_grasp_beside_the_object_fails_and_says_why(graph, scene_file) -> None:
    config = scene()
    node, tactile, told = start(graph, scene_file(config))
    send = graph.talk(GraspArray, "grasps")
    graph.matched("grasps")
    grasp = planned(config)
    aside = np.array([0.3, 0.0, 0.0])
    send.publish(grasps(Grasp(grasp.g1 + aside, grasp.g2 + aside, grasp.rotation), "beside", time.time_ns()))
    graph.until(lambda: told)
    assert (told[0].success, stamp_ns(told[0].contact), stamp_ns(told[0].release)) == (False, 0, 0)
    assert stamp_ns(told[0].start) > 0
    assert dict(node.statistics.summary().dropped) == {"misses": 1}
    counts = [tuple(finger_counts(m, "TH")) for m in tactile]
    assert len(set(counts)) == 1


def test_the_object_is_the_one_on_the_table_when_the_cloud_was_taken(graph, scene_file) -> None:
    config = scene(CAN | {"size_spread": 0.2})
    origin = time.time_ns() - 100 * SECOND
    _, tactile, told = start(
        graph, scene_file(config), scene__origin_ns=origin, scene__dwell_s=10.0, scene__samples=100
    )
    send = graph.talk(GraspArray, "grasps")
    graph.matched("grasps")
    for slot in (7, 8):
        send.publish(grasps(planned(config, slot), f"slot {slot}", origin + round((10 * slot + 3) * SECOND)))
        graph.until(lambda slot=slot: len(told) == slot - 6)
        report, touch = told[-1], run(config, "touch", slot=slot).touch
        assert report.success
        held = between(tactile, stamp_ns(report.contact), stamp_ns(report.release))
        np.testing.assert_array_equal(finger_counts(held[-1], "TH")[1:], touch.e_th)


def test_a_hand_that_is_restarted_goes_on_with_the_campaign(graph, scene_file) -> None:
    """The sensors were switched on 100 s ago, which are 30000 s of the campaign: 10 K warmer, and PDC rises 8 counts a kelvin."""
    warm_up = {"body_kelvin": 10.0, "warming_s": 1000.0}
    config = scene(campaign={"live_speed": 300.0, "warm_up": warm_up})
    origin = time.time_ns() - 100 * SECOND
    _, tactile, _ = start(graph, scene_file(config), scene__origin_ns=origin)
    graph.until(lambda: tactile)
    assert finger_counts(tactile[0], "TH")[0] == round(config.fingers.thumb.pdc_rest) + 80


def test_on_request_only(graph, scene_file) -> None:
    config = scene()
    node, _, told = start(graph, scene_file(config), automatic=False)
    assert (graph.call(Trigger, "execute_grasp", Trigger.Request()).message) == "there is no grasp"
    send = graph.talk(GraspArray, "grasps")
    graph.matched("grasps")
    send.publish(grasps(planned(config), "asked for", time.time_ns()))
    graph.until(lambda: node._newest is not None)
    time.sleep(0.2)
    assert node.phase == "idle"
    answer = graph.call(Trigger, "execute_grasp", Trigger.Request())
    assert (answer.success, answer.message) == (True, "asked for")
    again = graph.call(Trigger, "execute_grasp", Trigger.Request())
    assert (again.success, again.message) == (False, "the hand is busy")
    graph.until(lambda: told)
    assert graph.call(Trigger, "execute_grasp", Trigger.Request()).message == "there is no new grasp"


def test_grasps_of_another_frame_are_refused(graph, scene_file) -> None:
    config = scene()
    node, _, told = start(graph, scene_file(config))
    send = graph.talk(GraspArray, "grasps")
    graph.matched("grasps")
    send.publish(grasps(planned(config), "elsewhere", time.time_ns(), frame="map"))
    graph.until(lambda: node.statistics.summary().dropped)
    assert dict(node.statistics.summary().dropped) == {"refused": 1}
    assert not told
    send.publish(grasps(planned(config), "here", time.time_ns()))
    graph.until(lambda: told)


def test_stopping_in_the_middle_of_a_grasp_tells_nothing_of_it(graph, scene_file) -> None:
    config = scene()
    node, _, told = start(graph, scene_file(config))
    send = graph.talk(GraspArray, "grasps")
    graph.matched("grasps")
    send.publish(grasps(planned(config), "broken off", time.time_ns()))
    graph.until(lambda: node.phase == "hold")
    node.trigger_deactivate()
    assert (node.phase, dict(node.statistics.summary().dropped)) == ("idle", {"stopped": 1})
    node.trigger_activate()
    send.publish(grasps(planned(config), "whole", time.time_ns()))
    graph.until(lambda: told)
    assert [report.grasp_id for report in told] == ["whole"]


def failing(times: int, real: Callable[..., Any]) -> Callable[..., Any]:
    """A function that raises so many times and works from then on."""
    left = iter(range(times))

    def call(*arguments: Any) -> Any:
        if next(left, None) is None:
            return real(*arguments)
        raise FloatingPointError("overflow")

    return call


def test_messages_go_on_after_an_internal_error(graph, scene_file, monkeypatch) -> None:
    node, tactile, _ = start(graph, scene_file(scene()), diagnostics_period_s=0.1)
    reports = graph.listen(DiagnosticArray, "/diagnostics")
    graph.until(lambda: tactile)
    monkeypatch.setattr("foretouch.ros.nodes.hand.biotac_all_to_msg", failing(7, biotac_all_to_msg))
    graph.until(lambda: node.internal_errors.counts() == {"hand": 7})
    heard = len(tactile)
    graph.until(lambda: len(tactile) >= heard + 50)
    steps = np.diff([stamp_ns(m.header.stamp) for m in tactile])
    assert sorted(set(steps)) == [SECOND // 100, 8 * SECOND // 100]  # the stamps of the seven are left out

    def reported() -> bool:
        values = {pair.key: pair.value for one in reports for status in one.status for pair in status.values}
        return values.get("internal_errors.hand") == "7"

    graph.until(reported)


@pytest.mark.parametrize("broken", ["_executed_to_msg", "biotac_all_to_msg"])
def test_a_grasp_with_an_internal_error_has_failed_and_the_next_one_is_executed(
    graph, scene_file, monkeypatch, broken
) -> None:
    config = scene()
    node, _, told = start(graph, scene_file(config))
    send = graph.talk(GraspArray, "grasps")
    graph.matched("grasps")
    send.publish(grasps(planned(config), "first", time.time_ns()))
    graph.until(lambda: node.phase == "hold")
    real = getattr(hand, broken)
    monkeypatch.setattr(hand, broken, failing(1, real))
    graph.until(lambda: not node.busy)
    assert dict(node.statistics.summary().dropped) == {"failed": 1}
    assert node.internal_errors.counts() == {"hand": 1}
    send.publish(grasps(planned(config), "second", time.time_ns()))
    graph.until(lambda: told)
    assert [report.grasp_id for report in told] == ["second"]
    summary = node.statistics.summary()
    assert summary.received == 2 == summary.used + sum(summary.dropped.values())


def test_cleaning_up_releases_the_scene(graph, scene_file) -> None:
    node, _, _ = start(graph, scene_file(scene(CAN)))
    hand = weakref.ref(node._hand)
    node.trigger_deactivate()
    node.trigger_cleanup()
    assert hand() is None


def test_it_says_what_is_wrong_with_its_settings(graph, tmp_path) -> None:
    (node,) = graph.add("hand", scene__path=str(tmp_path / "none.yaml"))
    assert node.state_name == "unconfigured"
    with pytest.raises(ConfigError, match=r"biotacs: .* lacks TH or MF"):
        HandConfig(biotacs=("FF", "TH"))
