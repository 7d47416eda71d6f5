# SPDX-License-Identifier: Apache-2.0
"""Tables, live screens and progress bars: whole on terminals of any width, without remains of earlier frames."""

import re
import sys
from contextlib import suppress

import pytest
from every_case import every_case
from recording_builders import write_dataset
from rich.console import Console
from scene_builders import write_scenes
from terminal import ESCAPE, Terminal

from foretouch.cli.output import progress_bar
from foretouch.cli.screen import make_table
from foretouch.errors import ForetouchError

HEIGHT = 24
ERASE = "\x1b[2K"
COLUMNS = ["finger", "value", "span of the electrodes", "why"]
ROWS = [["thumb", "2931 ±158", "2737–3487 ±179", "adapted to three touches"], ["middle", "1858 ±99", "–", ""]]
ENTER, LEAVE = "\x1b[?1049h", "\x1b[?1049l"
BACK = re.compile(r"\x1b\[\d*[AFH]")  # the cursor goes back over what stands in the scrollback


def on_a_terminal(width: int, environment: dict[str, str], *words: object) -> str:
    """All that a command writes to a terminal, as it writes it."""
    command = [sys.executable, "-m", "foretouch", *map(str, words)]
    with Terminal(command, environment, width) as terminal:
        assert terminal.end() == 0, terminal.written
        return terminal.written


def whole(written: str, width: int) -> str:
    """The text without escape sequences, of which nothing is cut."""
    text = ESCAPE.sub("", written).replace("\r", "")
    assert "…" not in text
    assert max(map(len, text.splitlines()), default=0) <= width
    return text


def test_tables_are_whole_and_folded_on_a_terminal(call, files, tmp_path, monkeypatch, environment) -> None:
    dataset = tmp_path / "a-rather-long-name-of-a-dataset"
    write_dataset(dataset, 6, points=100)
    commands = (
        ("segment", files / "scene.npz"),
        ("predict", files / "object.pcd"),
        ("dataset", "info", dataset),
        ("dataset", "verify", dataset),
        ("experiment", "list"),
    )

    def check(width: int, words: tuple[object, ...]) -> None:
        monkeypatch.setenv("COLUMNS", str(width))
        answer = call(*words)
        assert answer.status == 0, answer.err
        long = [line for line in answer.out.splitlines() if len(line) > width]
        assert all("/" in line or ": " in line for line in long), long  # titles and remarks alone, in a pipe
        assert "…" not in answer.out

    every_case([(width, words) for width in (60, 80) for words in commands], check)
    assert "score" in whole(on_a_terminal(60, environment, "grasp", files / "scene.npz"), 60)


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
        assert "8 of 8 clouds answered" in " ".join(left.replace("│", " ").split())

    every_case([60, 80], check)


def test_nothing_is_cut_and_words_are_whole_as_long_as_they_fit() -> None:
    words = {word for row in [COLUMNS, *ROWS] for cell in row for word in cell.split()}

    def check(width: int, live: bool) -> None:
        console = Console(width=width, color_system=None)
        with console.capture() as captured:
            console.print(make_table(COLUMNS, ROWS, live=live))
        text = captured.get()
        assert max(map(len, text.splitlines()), default=0) <= width
        assert "…" not in text
        shown = {word for line in text.splitlines() for word in line.replace("│", " ").replace("┃", " ").split()}
        assert shown >= words or width < 50

    every_case([(width, live) for width in (30, 50, 80) for live in (False, True)], check)


def test_a_bar_advances_on_a_terminal_alone_unless_hidden_and_is_erased_in_the_end(capsys, monkeypatch) -> None:
    def shown(title: str, *updates: tuple[object, ...], error: str = "", **options: object) -> str:
        with suppress(ForetouchError), progress_bar(title, **options) as update:
            for values in updates:
                update(*values)
            if error:
                raise ForetouchError(error)
        out, err = capsys.readouterr()
        assert out == ""
        return err

    assert shown("simulating", (), total=3) == ""  # without a terminal
    for name, value in (("FORCE_COLOR", "1"), ("TERM", "xterm"), ("COLUMNS", "120")):
        monkeypatch.setenv(name, value)  # rich treats stderr as a terminal
    text = shown("reading the data", (7, 9, "label_ratio seed=1"), ())
    assert ("8/9" in text, "label_ratio seed=1" in text, text.endswith(ERASE)) == (True, True, True)
    assert shown("simulating", (), total=3, hidden=True) == ""
    assert shown("epoch", (), total=3, error="disk full").endswith(ERASE)
