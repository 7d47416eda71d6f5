# SPDX-License-Identifier: Apache-2.0
"""What stands on terminals of 60 and of 80 columns by 24 lines: whole, and without remains of earlier frames."""

from __future__ import annotations

import fcntl
import os
import pty
import re
import struct
import subprocess
import sys
import termios
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from recording_builders import write_dataset
from rich.console import Console
from scene_recordings import SceneRecordingConfig, record_scenes

from foretouch.cli.record import record_panel
from foretouch.cli.screen import FittedPanel
from foretouch.types import Grasp, Touch, TouchPrediction

HEIGHT = 24
ESCAPE = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]")
ENTER, LEAVE = "\x1b[?1049h", "\x1b[?1049l"

Call = Callable[..., Any]


@pytest.fixture(params=[60, 80])
def width(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> int:
    monkeypatch.setenv("COLUMNS", str(request.param))
    return int(request.param)


def on_a_terminal(width: int, environment: dict[str, str], *words: object) -> tuple[int, str]:
    """Exit status, and all that a command writes to a pseudo-terminal, as it writes it."""
    master, slave = pty.openpty()
    fcntl.ioctl(slave, termios.TIOCSWINSZ, struct.pack("HHHH", HEIGHT, width, 0, 0))
    environment = {name: text for name, text in environment.items() if name not in {"COLUMNS", "LINES"}}
    process = subprocess.Popen(
        [sys.executable, "-m", "foretouch.cli.main", *map(str, words)],
        stdin=slave,
        stdout=slave,
        stderr=slave,
        env={**environment, "TERM": "xterm-256color"},
        start_new_session=True,
    )
    os.close(slave)
    written = b""
    while True:
        try:
            more = os.read(master, 65536)
        except OSError:  # the other end is closed
            break
        if not more:
            break
        written += more
    os.close(master)
    return process.wait(timeout=60), written.decode()


def lines_of(written: str) -> list[str]:
    return ESCAPE.sub("", written).replace("\r", "").splitlines()


def require_whole(text: str, width: int) -> None:
    assert "…" not in text
    assert "..." not in text
    for line in text.splitlines():
        assert len(line) <= width, line


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("screens") / "a-rather-long-name-of-a-dataset"
    write_dataset(path, 6, points=100)
    return path


def test_tables_of_the_commands_are_whole(call: Call, files: Path, dataset: Path, width: int, tmp_path: Path) -> None:
    for words in (
        ("segment", files / "scene.npz"),
        ("grasp", files / "scene.npz"),
        ("models",),
        ("dataset", "info", dataset),
        ("dataset", "verify", dataset),
        ("dataset", "show", dataset, "-n", 1, "-o", tmp_path / "sheet.png"),
        ("experiment", "list"),
        ("tradeoff", "list"),
    ):
        answer = call(*words)
        assert answer.status == 0, answer.err
        tables = [line for line in answer.out.splitlines() if len(line) > width]
        assert all("/" in line or ": " in line for line in tables), tables  # titles and remarks alone, in a pipe
        assert "…" not in answer.out


def test_numbers_of_predictions_are_whole(call: Call, files: Path, width: int) -> None:
    (record,) = call("predict", files / "object.pcd", "--json").records
    out = call("predict", files / "object.pcd").out
    words = set(out.replace("│", " ").split())
    for prediction in record["predictions"]:
        for name in ("PDC_TH", "PDC_MF"):
            assert f"{prediction[name]['value']:.0f}" in words
        for name in ("E_TH", "E_MF"):
            value = prediction[name]["value"]
            assert f"{min(value):.0f}–{max(value):.0f}" in words
        half = [np.mean(np.subtract(prediction[n]["upper"], prediction[n]["lower"])) / 2 for n in ("PDC_TH", "E_MF")]
        assert {f"±{one:.0f}" for one in half} <= words
        for xyz in (prediction["grasp"]["g1"], prediction["grasp"]["g2"]):
            assert {f"{one:.3f}" for one in xyz} <= words


def test_what_several_models_have_in_common_is_told_once(call: Call) -> None:
    remarks = [line.partition(": ") for line in call("models").out.splitlines() if ": " in line]
    told = [remark for _, _, remark in remarks]
    assert len(told) == len(set(told))
    assert any(names == "all models" for names, _, _ in remarks)
    assert any(names == "contact-v1, touchnet-v1" for names, _, _ in remarks)


def test_scores_are_whole(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], width: int) -> None:
    from foretouch.cli.evaluate import show_scores

    score = {"rmse": 123.4, "nrmse": 0.0567, "skill": 0.123, "coverage90": 0.912}
    names = ("model", "mean", "geometry_trees", "object_time_trees", "nearest_neighbour")
    scores = {name: dict.fromkeys(("PDC_TH", "PDC_MF", "E_TH", "E_MF"), score) for name in names}
    show_scores({"samples": 123, "unfamiliar": 4, "scores": scores}, "random")
    out = capsys.readouterr().out
    assert out.count("0.0567") == out.count("+0.123") == 20
    assert out.count("object_time_trees") == 4
    assert "…" not in out


def screen(panel: FittedPanel, width: int) -> str:
    console = Console(width=width, height=HEIGHT, color_system=None)
    lines = console.render_lines(panel, console.options.update(height=HEIGHT))
    assert len(lines) == HEIGHT
    return "\n".join("".join(segment.text for segment in line).rstrip() for line in lines)


@pytest.mark.ros
def test_predicted_stands_against_read_whatever_else_there_is(width: int) -> None:
    pytest.importorskip("rclpy", reason="ROS 2 is not installed")
    from std_msgs.msg import Header

    from foretouch.cli.live import live_panel
    from foretouch.ros.messages.conversions import grasp_to_msg, prediction_to_msg
    from foretouch.ros.nodes.monitor import NodeView, View
    from foretouch_msgs.msg import TouchPredictionArray

    grasp = Grasp(np.array([0.03, 0.0, 0.8]), np.array([-0.03, 0.0, 0.8]), np.eye(3), object_id="1")
    touch = Touch.from_vector(
        np.concatenate([[2779.0, 1676.0], np.linspace(2512.0, 3497.0, 24), np.linspace(2605.0, 3306.0, 24)])
    )
    bounds = {name: Touch.from_vector(touch.vector() + shift) for name, shift in (("lower", -150.0), ("upper", 150.0))}
    prediction = TouchPrediction(grasp, touch, **bounds, reference="touches", flags=("unfamiliar", "out_of_range"))
    message = prediction_to_msg(prediction, grasp_to_msg(grasp), Header())
    view = View(last=TouchPredictionArray(predictions=[message] * 10))
    read = Touch.from_vector(touch.vector() + 21.0)
    view.executed = (message, SimpleNamespace(touch=read, tare=Touch.from_vector(touch.vector() - 200.0)))  # type: ignore[assignment]
    view.answers.update({"ok": 123, "no_object": 4})
    view.reasons.update({"no point above the table stands out": 4})
    for name in ("camera", "segmentation", "grasp", "touch_predictor", "hand", "markers"):
        values = {"state": "active", "rate_hz": "29.97", "received": "12345", "used": "12333", "dropped.late": "12"}
        values |= {"latency_ms.p50": "12.31", "latency_ms.p95": "145.63"}
        view.nodes[f"/foretouch/{name}"] = NodeView(0, "", values)
    text = screen(live_panel(view, "foretouch run: recording (Ctrl-C to end)"), width)
    require_whole(text, width)
    words = set(text.replace("│", " ").split())
    assert {"predicted", "read", "tare", "touch_predictor", "12345", "12333", "146"} <= words
    assert {"2779", "±150", "2512–3497", "2605–3306", "2800", "2533–3518"} <= words
    assert text.rstrip().endswith("╯")


@pytest.mark.ros
def test_the_state_of_a_recording_is_whole(width: int) -> None:
    pytest.importorskip("rclpy", reason="ROS 2 is not installed")
    from foretouch_msgs.msg import RecorderStatus, TopicAccount

    topics = [
        TopicAccount(
            topic=name, received=100123, written=97000, drop_reasons=["queue full"], drop_counts=[3123], lost=5
        )
        for name in (
            "/rh/tactile",
            *(f"/foretouch/{n}" for n in ("object_cloud", "table", "grasps", "touch", "executed_grasp")),
        )
    ]
    states = ["alive", "frozen: the same 300 times, or simulated without noise", "no data"]
    status = RecorderStatus(
        recording=True, samples=12, sensors=["TH", "MF", "camera"], sensor_states=states, topics=topics
    )
    status.reason = "disk full"
    text = screen(record_panel(status, "foretouch record (Ctrl-C ends it)"), width)
    require_whole(text, width)
    assert text.count("100123") == text.count("97000") == 6
    assert {"executed_grasp", "disk", "frozen:", "camera"} <= set(text.replace("│", " ").split())


@pytest.mark.ros
@pytest.mark.parametrize("columns", [60, 80])
def test_the_live_screen_of_run_leaves_one_table_behind(
    columns: int, tmp_path: Path, environment: dict[str, str]
) -> None:
    pytest.importorskip("rclpy", reason="ROS 2 is not installed")
    record_scenes(tmp_path / "recording", SceneRecordingConfig(count=8))
    words = ("run", "--source", tmp_path / "recording", "--rate", 5)
    status, written = on_a_terminal(columns, environment, *words)
    assert status == 0, written
    before, _, rest = written.partition(ENTER)
    live, _, after = rest.partition(LEAVE)
    assert "starting the nodes" in before
    for frame in live.split("\x1b[H")[1:]:
        assert len(lines_of(frame)) <= HEIGHT
        require_whole("\n".join(lines_of(frame)), columns)
    assert "waiting for the first: replay is" in " ".join(ESCAPE.sub("", live).replace("│", " ").split())
    assert ENTER not in after
    assert not re.search(r"\x1b\[\d*[AFH]", after), "the cursor goes back over what stands in the scrollback"
    left = "\n".join(lines_of(after))
    require_whole(left, columns)
    assert left.count("╭") == left.count("╰") == 1
    assert "waiting for the last answers" in left
    assert "8 clouds played" in " ".join(left.replace("│", " ").split())


@pytest.mark.ros
def test_the_live_screen_of_record_does_too(tmp_path: Path, environment: dict[str, str]) -> None:
    pytest.importorskip("rclpy", reason="ROS 2 is not installed")
    status, written = on_a_terminal(60, environment, "record", "-o", tmp_path / "set", "--seconds", 1)
    assert status == 0, written
    before, _, rest = written.partition(ENTER)
    live, _, after = rest.partition(LEAVE)
    assert "starting the recorder" in before
    assert "sensors" in live
    assert not re.search(r"\x1b\[\d*[AFH]", before + after)
    left = "\n".join(lines_of(after))
    assert left.count("╭") == left.count("╰") == 1
    assert "writing what is left" in left


def test_a_table_on_a_terminal_is_folded_with_its_title(files: Path, environment: dict[str, str]) -> None:
    status, written = on_a_terminal(60, environment, "grasp", files / "scene.npz")
    assert status == 0
    require_whole("\n".join(lines_of(written)), 60)
    assert "score (higher" in written
