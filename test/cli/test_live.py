# SPDX-License-Identifier: Apache-2.0
"""The live table: value, half width, what a prediction is based on, and its flags."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from rich.console import Console
from std_msgs.msg import Header

from foretouch.cli.live import live_panel
from foretouch.ros.messages.conversions import grasp_to_msg, prediction_to_msg, refusal_to_msg
from foretouch.ros.nodes.monitor import NodeView, View
from foretouch.types import Grasp, Touch, TouchPrediction
from foretouch_msgs.msg import Status, TouchPredictionArray

GRASP = Grasp(np.array([0.03, 0.0, 0.8]), np.array([-0.03, 0.0, 0.8]), np.eye(3), object_id="1")


def shown(prediction: TouchPrediction, touches: str = "3") -> str:
    message = prediction_to_msg(prediction, grasp_to_msg(GRASP), Header())
    message.model = "contact-v1"
    view = View(last=TouchPredictionArray(predictions=[message]))
    view.nodes["/foretouch/touch_predictor"] = NodeView(0, "", {"state": "active", "touches": touches})
    console = Console(width=80)
    with console.capture() as captured:
        console.print(live_panel(view, "title"))
    return captured.get()


def touch(shift: float = 0.0) -> Touch:
    return Touch.from_vector(np.concatenate([[2779.0, 1676.0], np.full(48, 3000.0)]) + shift)


def test_value_half_width_touches_and_flags_fit_on_a_narrow_terminal() -> None:
    bounds = {"lower": touch(-60.0), "upper": touch(60.0)}
    text = shown(TouchPrediction(GRASP, touch(), **bounds, reference="touches", flags=("unfamiliar",)))
    assert "±60" in text
    assert "2779" in text
    assert "3000–3000" in text
    assert "3 touches" in text
    assert "unfamiliar" in text
    assert "by contact-v1" in text


def test_without_a_calibration_there_is_no_half_width() -> None:
    text = shown(TouchPrediction(GRASP, touch()))
    assert "2779" in text
    assert "±" not in text
    assert "cloud only" in text


def test_a_refused_grasp_of_any_width_is_shown() -> None:
    message = refusal_to_msg(grasp_to_msg(GRASP), Header(), Status.BAD_GRASP, "grasp: too wide")
    message.grasp.g1.x = 1e160
    console = Console(width=80)
    with console.capture() as captured:
        console.print(live_panel(View(last=TouchPredictionArray(predictions=[message])), "title"))
    assert "too wide" in captured.get()
