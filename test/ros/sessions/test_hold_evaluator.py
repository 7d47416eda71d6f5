# SPDX-License-Identifier: Apache-2.0
"""Whether a grasp will hold, once for each grasp; and why it is not known."""

import time
from typing import Any

import numpy as np
import pytest
from robot_builders import RecordedRobot, start
from scipy.optimize import minimize

from foretouch.models.touch_hold import load_touch_hold
from foretouch.ros.sessions.hold_evaluator import HoldEvaluator
from foretouch.tactile.channels import BIOTAC_SP
from foretouch.tactile.contact_detector import SETTLE_NS
from foretouch.tactile.description import packaged_sensor
from foretouch_lab.ros.hand_messages import biotac_all_to_msg
from foretouch_msgs.msg import Status, TouchHold

pytestmark = pytest.mark.ros

MODEL, CARD = load_touch_hold()
FINGERS = CARD["config"]["fingers"]


def usual() -> np.ndarray:
    """(3, 24) electrodes [counts] whose pattern, of mean 0 and deviation 1, is well in the range of training."""
    low, high = (end.reshape(3, 24) for end in (MODEL.low, MODEL.high))
    rows = []
    for least, most in zip(low, high, strict=True):
        ends = least + np.outer([0.05, 0.95], most - least)
        found = minimize(
            lambda x: x.mean() ** 2 + (x.var() - 1.0) ** 2, 0.3 * ends[0] + 0.7 * ends[1], bounds=ends.T, tol=1e-12
        )
        rows.append(found.x)
    return (2600.0 + 400.0 * np.array(rows)).round()


USUAL = usual()
REST = {finger: np.r_[2000, row + 300].astype(np.int16) for finger, row in zip(FINGERS, USUAL, strict=True)}
PRESSED = {finger: np.r_[2150, row].astype(np.int16) for finger, row in zip(FINGERS, USUAL, strict=True)}


def message(fingers: dict[str, Any]) -> Any:
    return biotac_all_to_msg(fingers, "rh", 5)


def evaluated(rest: dict[str, Any] | None, pressed: dict[str, Any], sensor: Any = BIOTAC_SP) -> TouchHold:
    evaluator = HoldEvaluator(sensor)
    if rest is not None:
        evaluator.update(message(rest), 0, None, 0.0)
    found = evaluator.update(message(pressed), 5, SETTLE_NS, 9.0)
    assert found is evaluator.last
    return found


def test_a_grasp_is_evaluated_once_when_it_has_settled() -> None:
    evaluator = HoldEvaluator(BIOTAC_SP)
    assert (evaluator.last.status, evaluator.last.reason) == (Status.REFUSED, "no grasp has been held yet")
    assert np.isnan(evaluator.last.chance)
    answers = [
        evaluator.update(message(fingers), number, held_ns, 0.01 * number)
        for number, (fingers, held_ns) in enumerate(
            [
                (REST, None),
                (PRESSED, -1),
                (PRESSED, 0),
                (PRESSED, SETTLE_NS - 1),
                (PRESSED, SETTLE_NS),
                (PRESSED, 2 * SETTLE_NS),
                (REST, -1),
                (PRESSED, 2 * SETTLE_NS),
                (REST, None),
                (PRESSED, SETTLE_NS),
            ]
        )
    ]
    assert [k for k, answer in enumerate(answers) if answer is not None] == [4, 9]
    found = answers[4]
    assert (found.status, found.reason, found.fingers, found.header.stamp.nanosec) == (Status.OK, "", FINGERS, 4)
    assert (found.model, found.model_sha256) == ("touch-hold", CARD["sha256"])
    counts = np.array([PRESSED[finger][1:] for finger in FINGERS], float)
    assert found.chance == pytest.approx(MODEL.chance(counts[None])[0], rel=1e-6)


ODD = {finger: np.r_[2150, counts[:0:-1]].astype(np.int16) for finger, counts in PRESSED.items()}
BROKEN = {**PRESSED, "MF": np.r_[2150, 0, PRESSED["MF"][2:]].astype(np.int16)}
REFUSED: dict[str, tuple[Any, ...]] = {
    "no third BioTac": (REST, {finger: PRESSED[finger] for finger in ("TH", "MF")}, "electrodes cannot be used: 24 not_read"),
    "an electrode out of range": (REST, BROKEN, "electrodes cannot be used: 1 out_of_range"),
    "two fingers grasp": (REST, {**PRESSED, "FF": REST["FF"]}, "FF does not touch, and the model is of grasps with TH, MF, FF"),
    "no rest": (None, PRESSED, "there is no reading without contact that shows which fingers touch"),
    "not as in training": (REST, ODD, "of the pattern is out of the range of training"),
    "another sensor": (REST, PRESSED, "the sensor is not biotac_sp on TH, MF, FF", packaged_sensor("xela_uskin_4x4")),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_what_the_model_does_not_know_is_refused_with_a_reason(name: str) -> None:
    rest, pressed, reason, *sensor = REFUSED[name]
    found = evaluated(rest, pressed, *sensor)
    assert found.status == Status.REFUSED
    assert found.reason.endswith(reason)
    assert np.isnan(found.chance)


class ThreeFingers(RecordedRobot):
    """A hand whose first finger reads what its middle finger does in `PRESSED`."""

    def message(self, counts: np.ndarray) -> Any:
        return biotac_all_to_msg({name: counts[25 * k : 25 * k + 25] for k, name in enumerate(FINGERS)}, "rh", self.now)

    noise = np.tile(np.r_[0.3, np.full(24, 4.0)], 3)


def test_the_recorder_publishes_it_and_keeps_it_in_its_status(graph: Any, tmp_path: Any) -> None:
    told = graph.listen(TouchHold, "touch_hold")
    node, robot, _ = start(graph, tmp_path / "set")
    graph.until(lambda: node.recording)
    assert node.status().touch_hold.status == Status.REFUSED
    robot.__class__ = ThreeFingers
    robot.now = time.time_ns()
    for fingers, readings in ((REST, 120), (PRESSED, 60), (REST, 40), (PRESSED, 60), (REST, 20)):
        robot.feel(np.concatenate([fingers[name] for name in FINGERS]), readings)
    graph.until(lambda: len(told) == 2)
    assert [(one.status, one.reason) for one in told] == [(Status.OK, "")] * 2
    assert all(0.0 <= one.chance <= 1.0 for one in told)
    graph.until(lambda: node.status().touch_hold.header == told[-1].header)
    assert node.status().touch_hold.chance == pytest.approx(told[-1].chance, rel=1e-6)
