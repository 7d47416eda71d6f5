# SPDX-License-Identifier: Apache-2.0
"""`foretouch simulate`: a data set of a scene, its plan, its samples again, and mistakes in one line."""

import re
from pathlib import Path

import pytest
from every_case import every_case

from foretouch.dataset.store import Store, content_sha256
from foretouch_lab.cli.simulate import SHEET

SCENE = "objects: [{name: can, shape: can, size_m: [0.07, 0.07, 0.1], pose: {rest: side}}]\n"
SLIPPERY = SCENE.replace("rest: side}", "rest: side}, friction: 0.01")


@pytest.fixture
def scene(tmp_path) -> Path:
    path = tmp_path / "scene.yaml"
    path.write_text(SCENE)
    return path


def test_explain_runs_nothing_and_names_what_would_run(scene, call) -> None:
    answer = call("simulate", scene, "--explain", "--json")
    assert answer.status == 0
    effects = {e["name"]: e for e in answer.records[-1]["effects"]}
    assert (effects["contact"]["ran"], effects["contact"]["reason"]) == (True, "fidelity")
    assert (effects["depth_noise"]["ran"], effects["depth_noise"]["reason"]) == (False, "no camera.noise")
    assert list(scene.parent.iterdir()) == [scene]


def test_a_data_set_is_written_whole(scene, tmp_path, call) -> None:
    answer = call("simulate", scene, "-n", 3, "-o", tmp_path / "ds", "--workers", 1, "--json")
    assert answer.status == 0
    record, store = answer.records[-1], Store(tmp_path / "ds")
    assert content_sha256(store) == store.sha256
    assert record["samples"] == len(store) == 3
    assert (record["sha256"], record["samples_per_s"] > 0) == (store.sha256, True)
    ran = {effect["name"] for effect in record["effects"] if effect["ran"]}
    assert "render" in ran
    assert "depth_noise" not in ran
    planned = call("simulate", scene, "--explain", "--json").records[-1]["effects"]
    assert ran == {effect["name"] for effect in planned if effect["ran"]}
    calls = {e["name"]: e["calls"] for e in record["effects"]}
    assert (calls["counts"], calls["slip"]) == (3, 0)
    assert store.manifest["about"]["scene_sha256"] == record["scene_sha256"]
    assert store.manifest["about"]["scene"]["objects"][0]["name"] == "can"
    assert (tmp_path / "ds" / SHEET).read_bytes().startswith(b"\x89PNG")


def test_seed_and_settings_from_the_command_line(scene, tmp_path, call) -> None:
    words = ("-n", 1, "--workers", 1, "--no-sheet", "--set", "grasps.thumb.force_n=[2, 2]")
    told = call("simulate", scene, *words, "-o", tmp_path / "a").out
    assert re.match(r"1 samples in .*, [\d.]+ a second; failed tries: none\nsha256 [0-9a-f]+\n$", told)
    assert not (tmp_path / "a" / SHEET).exists()
    assert "without stamps" in call("dataset", "info", tmp_path / "a").out  # and no day in 1970
    again = call("simulate", scene, *words, "-o", tmp_path / "b", "--json").records[-1]
    other = call("simulate", scene, *words, "-o", tmp_path / "c", "--seed", 1, "--json").records[-1]
    first = Store(tmp_path / "a")
    assert first.sha256 == again["sha256"] != other["sha256"]
    assert first[0].extra["force_th_n"] == pytest.approx(2.0, rel=1e-3)


def test_mistakes_are_one_line_and_leave_no_data_set(scene, tmp_path, call) -> None:
    slippery, out = tmp_path / "slippery.yaml", tmp_path / "ds"
    slippery.write_text(SLIPPERY + "max_attempts: 2\n")

    def check(words: tuple[object, ...], message: str) -> None:
        call("simulate", *words).check_refused(message)

    cases = [
        ((scene,), "-n and -o are needed"),
        ((scene, "-n", "3", "-o", "."), "exists already"),
        ((scene, "--set", "camera.zoom=2", "--explain"), "camera.zoom: unknown setting"),
        ((slippery, "-n", 2, "-o", out, "--workers", 1), "slot 0: given up after 2 attempts (2 slips)"),
    ]
    every_case(cases, check)
    assert not out.exists()
