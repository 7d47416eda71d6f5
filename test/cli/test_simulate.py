# SPDX-License-Identifier: Apache-2.0
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from foretouch.cli.simulate import SHEET
from foretouch.dataset.store import Store

SCENE = """
objects:
  - {name: can, shape: can, size_m: [0.07, 0.07, 0.1], pose: {rest: side}}
"""


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    path = tmp_path / "scene.yaml"
    path.write_text(SCENE)
    return path


def test_explain_runs_nothing_and_tells_all(scene: Path, call: Callable[..., Any]) -> None:
    answer = call("simulate", scene, "--explain", "--json")
    assert answer.status == 0
    told = {e["name"]: e for e in answer.records[-1]["effects"]}
    assert told["contact_winkler"]["ran"]
    assert "rigid" in told["contact_winkler"]["reason"]
    assert not told["depth_noise"]["ran"]
    assert told["depth_noise"]["reason"] == "no camera.noise"
    assert list(scene.parent.iterdir()) == [scene]


def test_a_data_set_is_written_whole(scene: Path, tmp_path: Path, call: Callable[..., Any]) -> None:
    answer = call("simulate", scene, "-n", 5, "-o", tmp_path / "ds", "--workers", 1, "--json")
    assert answer.status == 0
    record = answer.records[-1]
    store = Store(tmp_path / "ds")
    store.verify()
    assert record["samples"] == len(store) == 5
    assert record["sha256"] == store.sha256
    assert record["samples_per_s"] > 0
    calls = {e["name"]: e["calls"] for e in record["effects"]}
    assert calls["counts"] == 5
    assert calls["contact_layer"] == 0
    assert store.manifest["about"]["scene_sha256"] == record["scene_sha256"]
    assert store.manifest["about"]["scene"]["objects"][0]["name"] == "can"
    assert (tmp_path / "ds" / SHEET).read_bytes().startswith(b"\x89PNG")


def test_a_person_gets_a_table(scene: Path, tmp_path: Path, call: Callable[..., Any]) -> None:
    answer = call("simulate", scene, "-n", 1, "-o", tmp_path / "ds", "--workers", 1, "--no-sheet")
    assert answer.status == 0
    assert "contact_winkler" in answer.out
    assert "failed tries: none" in answer.out
    assert not (tmp_path / "ds" / SHEET).exists()


def test_seed_and_settings_from_the_command_line(scene: Path, tmp_path: Path, call: Callable[..., Any]) -> None:
    words = ("-n", 1, "--workers", 1, "--no-sheet", "--json", "--set", "grasps.thumb.force_n=[2, 2]")
    first = call("simulate", scene, *words, "-o", tmp_path / "a").records[-1]
    again = call("simulate", scene, *words, "-o", tmp_path / "b").records[-1]
    other = call("simulate", scene, *words, "-o", tmp_path / "c", "--seed", 1).records[-1]
    assert first["sha256"] == again["sha256"] != other["sha256"]
    assert Store(tmp_path / "a")[0].extra["force_th_n"] == pytest.approx(2.0, rel=1e-3)


def test_a_try_can_be_replayed(scene: Path, tmp_path: Path, call: Callable[..., Any]) -> None:
    call("simulate", scene, "-n", 3, "-o", tmp_path / "ds", "--workers", 1, "--no-sheet")
    record = call("simulate", scene, "--replay", "2", "--json").records[-1]
    touch = Store(tmp_path / "ds")[2].touch
    assert touch is not None
    assert record["status"] == "ok"
    assert record["touch"] == touch.vector().tolist()
    scene.write_text(SCENE.replace("rest: side}", "rest: side}, friction: 0.01"))
    failed = call("simulate", scene, "--replay", "0.3", "--json").records[-1]
    assert (failed["status"], failed["reason"], failed["attempt"]) == ("failed", "slips", 3)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ((), "-n and -o are needed"),
        (("-n", "3", "-o", "."), "exists already"),
        (("--replay", "x"), "--replay: x is not SLOT"),
        (("--set", "camera.zoom=2", "--explain"), "camera.zoom: unknown setting"),
    ],
)
def test_wrong_words_are_told_in_one_line(
    scene: Path, words: tuple[str, ...], message: str, call: Callable[..., Any]
) -> None:
    answer = call("simulate", scene, *words)
    assert answer.status == 1
    assert message in answer.err
    assert answer.err.count("\n") == 1


def test_a_slot_that_is_given_up_leaves_no_data_set(scene: Path, tmp_path: Path, call: Callable[..., Any]) -> None:
    scene.write_text(SCENE.replace("rest: side}", "rest: side}, friction: 0.01") + "\nmax_attempts: 2\n")
    answer = call("simulate", scene, "-n", 2, "-o", tmp_path / "ds", "--workers", 1)
    assert answer.status == 1
    assert "slot 0: given up after 2 attempts (2 slips)" in answer.err
    assert not (tmp_path / "ds").exists()
