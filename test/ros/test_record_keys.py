# SPDX-License-Identifier: Apache-2.0
"""`foretouch record` on a terminal: keys act within a fifth of a second, and the terminal is as before at the end."""

import sys
import termios

import pytest
from robot_builders import Robot
from terminal import Terminal

from foretouch.dataset.recordings.editing import undo
from foretouch.dataset.recordings.edits import read_edits
from foretouch.dataset.recordings.reader import RecordedDataset
from foretouch.dataset.recordings.repair import repair_dataset

pytestmark = [pytest.mark.ros, pytest.mark.slow]

QUICK = ["pairing.guard_s=0.02", "pairing.tare_s=0.2", "pairing.wait_s=1.0", "pairing.clock_s=10.0"]


@pytest.fixture
def record(lone_graph, tmp_path):
    """Starts `foretouch record` on a terminal, and a robot beside it."""

    def start(*words):
        lines = [f"    {key}: {value}" for key, _, value in (one.partition("=") for one in QUICK)]
        params = tmp_path / "params.yaml"
        params.write_text("\n".join(["/foretouch/recorder:", "  ros__parameters:", *lines]), encoding="utf-8")
        command = [sys.executable, "-m", "foretouch", "record", "-o", str(tmp_path / "set"), "--params", str(params)]
        terminal = Terminal([*command, *words], lone_graph.environment())
        terminal.until("[q]uit")
        return terminal, Robot(lone_graph)

    return start


def execute(terminal, robot, name, number):
    robot.grasp(name, number)
    terminal.until(f" {number + 1} samples")


def samples(path):
    return [(one.id, one.outcome, one.note) for one in RecordedDataset(path)]


def test_keys_label_relabel_note_drop_pause_undo_and_quit_and_are_acknowledged_at_once(record, tmp_path):
    terminal, robot = record("--objects", "can", "cup", "sponge")
    with terminal:
        assert not terminal.attributes()[3] & (termios.ICANON | termios.ECHO)
        execute(terminal, robot, "g-0", 0)
        execute(terminal, robot, "g-1", 1)
        took = []
        for typed, answer in (
            ("s", "can/000002: success"),
            ("f", "can/000002: failure"),
            ("n", "note: "),
            ("tïlted\x7f!\n", "can/000002: note tïlte!"),
            ("d", "can/000002: dropped"),
            ("f", "not done: can/000002: is dropped; undo that first"),
            ("u", "can/000002: undone: dropped"),
            ("r", "object of the last grasp"),
            ("bowl\n", "can/000002: is bowl"),
            ("\x1b[A", "can/000002: is bowl"),
            ("o", "name of the next object"),
            ("\n", "on the table: cup"),
            ("p", "paused: nothing is recorded"),
            ("p", "recording goes on"),
        ):
            terminal.type(typed)
            took.append(terminal.until(answer, 5.0))
        assert sorted(took)[len(took) // 2] < 0.2, took
        lines = terminal.frame()
        frame = "\n".join(lines)
        assert len(lines) <= 24, frame
        for words in ("cup 0", "can 1 success", "bowl 1 failure", "executed_grasp", "read "):
            assert words in frame, frame
        terminal.type("q")
        terminal.until("press q again")
        terminal.type("s")
        terminal.until("bowl/000002: success")
        terminal.type("q")
        terminal.type("q")
        assert terminal.end() == 0, terminal.written
        assert terminal.attributes() == terminal.before
    assert samples(tmp_path / "set") == [("can/000001", "success", ""), ("bowl/000002", "success", "tïlte!")]


def test_ctrl_z_is_ignored_and_what_was_acknowledged_is_kept_after_a_kill(record, tmp_path):
    terminal, robot = record("--object", "can")
    with terminal:
        execute(terminal, robot, "g-0", 0)
        terminal.type("f")
        terminal.until("can/000001: failure")
        terminal.type("\x1a")
        terminal.type("d")
        terminal.until("can/000001: dropped")
        terminal.process.kill()
        terminal.process.wait(10.0)
    repair_dataset(tmp_path / "set")
    (one,) = RecordedDataset(tmp_path / "set")
    assert (one.outcome, one.flags) == ("failure", ("discarded",))
    assert [edit.action for edit in read_edits(tmp_path / "set").edits] == ["outcome", "drop"]
    assert undo(tmp_path / "set") == 2
