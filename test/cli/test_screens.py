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
from typing import Any

import pytest
from every_case import every_case
from recording_builders import write_dataset
from scene_builders import write_scenes

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


def test_tables_of_the_commands_are_whole(call, files, tmp_path, monkeypatch) -> None:
    dataset = tmp_path / "a-rather-long-name-of-a-dataset"
    write_dataset(dataset, 6, points=100)
    commands = (
        ("segment", files / "scene.npz"),
        ("grasp", files / "scene.npz"),
        ("predict", files / "object.pcd"),
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


@pytest.mark.slow
@pytest.mark.ros
def test_a_live_screen_leaves_one_table_behind(tmp_path, environment) -> None:
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
    written = on_a_terminal(60, environment, "record", "-o", tmp_path / "set", "--seconds", 1)
    before, _, rest = written.partition(ENTER)
    live, _, after = rest.partition(LEAVE)
    assert "starting the recorder" in before
    assert "sensors" in live
    assert not BACK.search(before + after)
    assert "writing what is left" in after
    assert after.count("╭") == after.count("╰") == 1


def test_a_table_on_a_terminal_is_folded_with_its_title(files, environment) -> None:
    assert "score (higher" in whole(on_a_terminal(60, environment, "grasp", files / "scene.npz"), 60)
