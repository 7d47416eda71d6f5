# SPDX-License-Identifier: Apache-2.0
"""What stands on the live screens of `run` and `record`, whole at 60 and at 80 columns by 24 lines."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from every_case import every_case
from rich.console import Console
from rich.panel import Panel

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from answer_builders import refusal, touch_message

from foretouch.cli.keys import RecordingKeys
from foretouch.cli.live import live_panel
from foretouch.cli.record import record_panel
from foretouch.errors import ConfigError
from foretouch.ros.messages.conversions import grasp_to_msg
from foretouch.ros.nodes.monitor import View
from foretouch.ros.sessions.operator import OperatorState, Reply
from foretouch.ros.sessions.session import SessionStatus
from foretouch.tactile import biotac_touch
from foretouch.types import Evidence, Grasp, Prediction, Touch
from foretouch_msgs.msg import RecorderStatus, TopicAccount, TouchPredictionArray

HEIGHT = 24
GRASP = Grasp(np.array([0.03, 0.0, 0.8]), np.array([-0.03, 0.0, 0.8]), np.eye(3), object_id="1")
ELECTRODES = (np.linspace(2512.0, 3497.0, 24), np.linspace(2605.0, 3306.0, 24))
TOUCH = biotac_touch(np.concatenate([[2779.0, 1676.0], *ELECTRODES]))


def shifted(counts: float) -> Touch:
    return biotac_touch(TOUCH.values + counts)


BOUNDS = {"lower": shifted(-150.0), "upper": shifted(150.0)}
READINGS: Any = SimpleNamespace(touch=shifted(21.0), tare=shifted(-200.0))


def message(**fields: Any) -> Any:
    return touch_message(Prediction.of(GRASP, TOUCH, **fields), grasp_to_msg(GRASP), model="contact-v3")


def screen(panel: Panel, width: int) -> set[str]:
    """The words on a screen, none of which is cut."""
    console = Console(width=width, height=HEIGHT, color_system=None)
    lines = console.render_lines(panel, console.options.update(height=HEIGHT))
    assert len(lines) == HEIGHT
    text = ["".join(segment.text for segment in line).rstrip() for line in lines]
    assert max(map(len, text)) <= width
    assert not any("…" in line or "..." in line for line in text)
    assert "\n".join(text).rstrip().endswith("╯")
    return set(" ".join(text).replace("│", " ").split())


def printed(panel: Panel) -> str:
    console = Console(width=100, color_system=None)
    with console.capture() as captured:
        console.print(panel)
    return captured.get()


def test_predicted_stands_against_read_whatever_else_there_is() -> None:
    last = message(**BOUNDS, reference="touches", flags=("unfamiliar", "out_of_range"))
    view = View(last=TouchPredictionArray(predictions=[last] * 10))
    view.executed = (last, READINGS)
    view.answers.update({"ok": 123, "no_object": 4})
    view.count_reason("no point above the table stands out")
    for name in ("camera", "segmentation", "grasp", "touch_predictor", "hand", "markers"):
        values = {"state": "active", "rate_hz": "29.97", "received": "12345", "used": "12333", "dropped.late": "12"}
        values |= {"latency_ms.p50": "12.31", "latency_ms.p95": "145.63"}
        view.nodes[f"/foretouch/{name}"] = 0, "", values

    def check(width: int) -> None:
        words = screen(live_panel(view, "foretouch run: recording (Ctrl-C to end)"), width)
        assert {"predicted", "read", "tare", "grasp", "12345", "12333", "146"} <= words
        assert {"2779", "±150", "2512–3497", "2605–3306", "2800", "2533–3518"} <= words

    every_case([60, 80], check)


def test_reasons_are_counted_by_kind_and_the_last_of_each_is_shown() -> None:
    view = View()
    for reason in ("12 mm wide, less than 20", "16.1 mm wide, less than 20"):
        view.count_reason(reason)
    view.count_reason("no point #")
    for reason in ("encoding: 'rgb8' is not 16UC1 (grasp 17/1/0, -1.2e+03 m, 60%)", "two g1: 848x480"):
        view.count_reason(reason)
    assert list(view.reasons)[2:] == ["encoding: 'rgb8' is not 16UC1 (grasp #/#/#, # m, #%)", "two g1: 848x480"]
    text = printed(live_panel(view, "title"))
    assert "2 x last: 16.1 mm wide, less than 20" in text
    assert "1 x no point #" in text


def test_what_a_prediction_is_based_on_and_its_flags_are_shown() -> None:
    touched = message(reference="touches", evidence=Evidence(touches=3), flags=("unfamiliar",))
    view = View(last=TouchPredictionArray(predictions=[touched]))
    values = {
        "state": "active",
        "dropped.late": "12",
        "touches.refused.late_readings": "7",
        "touches.refused.aborted": "0",
    }
    view.nodes["/foretouch/touch_predictor"] = 1, "no camera", values
    view.last.predictions[0].grasp.hand = "franka_hand"
    text = printed(live_panel(view, "title"))
    assert "±" not in text, "without a calibration there is no half width"
    for words in (
        "2779",
        "2512–3497",
        "3 touches",
        "unfamiliar",
        "by contact-v3 for franka_hand",
        "12 late",
        "no camera",
    ):
        assert words in text
    assert "touch_predictor refused touches in total: 7 late readings " in text
    assert "aborted" not in text
    assert "cloud only" in printed(live_panel(View(last=TouchPredictionArray(predictions=[message()])), "title"))
    refused = touch_message(refusal("bad_grasp", "grasp: too wide"), grasp_to_msg(GRASP))
    refused.grasp.g1.x = 1e160
    assert "too wide" in printed(live_panel(View(last=TouchPredictionArray(predictions=[refused])), "title"))


def test_a_session_is_whole_with_objects_the_last_grasp_dead_sensors_and_keys() -> None:
    names = ("object_cloud", "table", "grasps", "touch", "executed_grasp", "points")
    names = ("/rh/tactile", *(f"/foretouch/{name}" for name in names))
    lost: dict[str, Any] = {"drop_reasons": ["paused"], "drop_counts": [117], "lost": 5}
    status = RecorderStatus(
        recording=True,
        topics=[TopicAccount(topic=name, received=100123, written=97000, rate=99.8, **lost) for name in names],
        samples=128,
        last_sample="can/000128",
        disk_left=6e4,
        sensors=["TH", "MF", "camera"],
        sensor_states=["alive", "frozen: the same 300 times", "no data"],
        outcomes=["no_tare", "recorded"],
        outcome_counts=[2, 128],
        pairing_error=0.012,
        pairing_error_max=0.034,
        drop_reasons=["paused", "queue full"],
        drop_counts=[819, 3],
    )
    state = OperatorState(
        object="can",
        paused=True,
        grasps={"cup": {"success": 40, "dropped": 2}, "can": {"success": 70, "failure": 16}, "sponge": {}},
    )
    session = SessionStatus(operator=state, last=(message(**BOUNDS), READINGS))
    keys = RecordingKeys(lambda action, text: f"{action} {text}")
    keys.press("s")
    panel = record_panel(status, "foretouch record (Ctrl-C ends it)", session, keys.lines(None))
    words = screen(panel, 80)
    assert {"117", "dropped:", "819", "paused,", "full", "frozen:", "no", "can/000128"} <= words
    assert {"success", "[q]uit", "PAUSED", "predicted", "read", "tare", "executed_grasp", "points", "sponge"} <= words
    assert {"2779", "±150", "2800", "17", "MF", "100123"} <= words
    text = printed(panel)
    assert "2 no tare, 128 recorded; pairing error 12 ms, at most 34" in text
    assert "flags" not in text
    session = SessionStatus(operator=state, last=(message(**BOUNDS, flags=("unfamiliar", "other_shape")), READINGS))
    assert "the prediction's flags: unfamiliar, other shape" in printed(
        record_panel(status, "foretouch record", session)
    )
    assert "disk full in 17 h" in text
    status.disk_left = 4e5
    assert "disk full in 5 days" in printed(record_panel(status, "", session))
    for topic in status.topics:
        topic.received = 0
    assert "start `foretouch run`" not in printed(record_panel(status, "", session))
    status.duration.sec = 5
    assert "start `foretouch run`" in printed(record_panel(status, "", session))
    for topic in status.topics:
        topic.received = 100123
    status.reason, empty = "disk full", SessionStatus()
    assert {"100123", "disk"} <= screen(record_panel(status, "foretouch record", empty), 60)


def test_keys_act_ask_and_quit_only_when_asked_twice() -> None:
    done = []

    def act(action: str, text: str) -> str:
        if action == "drop":
            raise ConfigError("disk full")
        done.append((action, text))
        return f"{action} {text}".strip()

    keys = RecordingKeys(act)
    said = lambda: [str(line) for line in keys.lines(None)]  # noqa: E731
    assert said()[1] == "[o]bject [s]uccess [f]ailure [d]rop [r]elabel [n]ote [p]ause [u]ndo [q]uit"
    keys.press("ocuX\x7fp\nsd")
    assert done == [("object", "cup"), ("success", "")]
    assert said()[0] == "not done: disk full"
    assert str(keys.lines(Reply("later", True, 1e18))[0]) == "later"
    keys.press("rab")
    assert said()[0] == "object of the last grasp (Enter: the one on the table): ab▏"
    keys.press("\x1bqzq")
    assert (keys.quitted, said()[0]) == (False, "press q again to end the recording, or any other key")
    keys.press("zqq")
    assert keys.quitted
    assert done == [("object", "cup"), ("success", "")]
