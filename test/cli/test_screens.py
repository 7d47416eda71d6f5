# SPDX-License-Identifier: Apache-2.0
"""What commands print on terminals of 60 and of 80 columns: whole, and without remains of earlier frames."""

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
from typing import Any

import numpy as np
import pytest
from every_case import every_case
from recording_builders import write_dataset
from scene_builders import write_scenes

from foretouch.cli.evaluate import show_scores

HEIGHT = 24
ESCAPE = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]")
ENTER, LEAVE = "\x1b[?1049h", "\x1b[?1049l"
BACK = re.compile(r"\x1b\[\d*[AFH]")  # the cursor goes back over what stands in the scrollback

Call = Callable[..., Any]


def on_a_terminal(width: int, environment: dict[str, str], *words: object) -> str:
    """All that a command writes to a pseudo-terminal, as it writes it."""
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
    assert process.wait(timeout=60) == 0, written.decode()
    return written.decode()


def whole(written: str, width: int) -> str:
    """The text without escape sequences, of which nothing is cut."""
    text = ESCAPE.sub("", written).replace("\r", "")
    assert "…" not in text
    assert "..." not in text
    for line in text.splitlines():
        assert len(line) <= width, line
    return text


def test_tables_of_the_commands_are_whole(
    call: Call, files: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    dataset = tmp_path / "a-rather-long-name-of-a-dataset"
    write_dataset(dataset, 6, points=100)
    commands = (
        ("segment", files / "scene.npz"),
        ("grasp", files / "scene.npz"),
        ("models",),
        ("dataset", "info", dataset),
        ("dataset", "verify", dataset),
        ("dataset", "show", dataset, "-n", 1, "-o", tmp_path / "sheet.png"),
        ("experiment", "list"),
        ("tradeoff", "list"),
    )

    def check(width: int, words: tuple[object, ...]) -> None:
        monkeypatch.setenv("COLUMNS", str(width))
        answer = call(*words)
        assert answer.status == 0, answer.err
        long = [line for line in answer.out.splitlines() if len(line) > width]
        assert all("/" in line or ": " in line for line in long), long  # titles and remarks alone, in a pipe
        assert "…" not in answer.out

    every_case([(width, words) for width in (60, 80) for words in commands], check)


def test_numbers_of_predictions_and_scores_are_whole(
    call: Call, files: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (record,) = call("predict", files / "object.pcd", "--json").records
    score = {"rmse": 123.4, "nrmse": 0.0567, "skill": 0.123, "coverage90": 0.912}
    names = ("model", "mean", "geometry_trees", "object_time_trees", "nearest_neighbour")
    scores = {name: dict.fromkeys(("PDC_TH", "PDC_MF", "E_TH", "E_MF"), score) for name in names}

    def check(width: int) -> None:
        monkeypatch.setenv("COLUMNS", str(width))
        words = set(call("predict", files / "object.pcd").out.replace("│", " ").split())
        for one in record["predictions"]:
            assert {f"{one[name]['value']:.0f}" for name in ("PDC_TH", "PDC_MF")} <= words
            spans = [(min(one[name]["value"]), max(one[name]["value"])) for name in ("E_TH", "E_MF")]
            assert {f"{low:.0f}–{high:.0f}" for low, high in spans} <= words
            half = [np.mean(np.subtract(one[n]["upper"], one[n]["lower"])) / 2 for n in ("PDC_TH", "E_MF")]
            assert {f"±{value:.0f}" for value in half} <= words
            assert {f"{x:.3f}" for x in (*one["grasp"]["g1"], *one["grasp"]["g2"])} <= words
        show_scores({"samples": 123, "unfamiliar": 4, "scores": scores}, "random")
        out = capsys.readouterr().out
        assert out.count("0.0567") == out.count("+0.123") == 20
        assert out.count("object_time_trees") == 4
        assert "…" not in out

    every_case([60, 80], check)


@pytest.mark.slow
@pytest.mark.ros
def test_the_live_screen_of_run_leaves_one_table_behind(tmp_path: Path, environment: dict[str, str]) -> None:
    pytest.importorskip("rclpy", reason="ROS 2 is not installed")
    recording = write_scenes(tmp_path / "recording", 8)

    def check(width: int) -> None:
        before, _, rest = on_a_terminal(width, environment, "run", "--source", recording, "--rate", 5).partition(ENTER)
        live, _, after = rest.partition(LEAVE)
        assert "starting the nodes" in before
        for frame in live.split("\x1b[H")[1:]:
            assert len(whole(frame, width).splitlines()) <= HEIGHT
        words = " ".join(ESCAPE.sub("", live).replace("│", " ").split())
        assert "waiting for the first: replay is" in words
        assert ENTER not in after
        assert not BACK.search(after)
        left = whole(after, width)
        assert left.count("╭") == left.count("╰") == 1
        assert "waiting for the last answers" in left
        assert "8 clouds played" in " ".join(left.replace("│", " ").split())

    every_case([60, 80], check)


@pytest.mark.slow
@pytest.mark.ros
def test_the_live_screen_of_record_does_too(tmp_path: Path, environment: dict[str, str]) -> None:
    pytest.importorskip("rclpy", reason="ROS 2 is not installed")
    written = on_a_terminal(60, environment, "record", "-o", tmp_path / "set", "--seconds", 1)
    before, _, rest = written.partition(ENTER)
    live, _, after = rest.partition(LEAVE)
    assert "starting the recorder" in before
    assert "sensors" in live
    assert not BACK.search(before + after)
    left = ESCAPE.sub("", after)
    assert left.count("╭") == left.count("╰") == 1
    assert "writing what is left" in left


def test_a_table_on_a_terminal_is_folded_with_its_title(files: Path, environment: dict[str, str]) -> None:
    assert "score (higher" in whole(on_a_terminal(60, environment, "grasp", files / "scene.npz"), 60)
