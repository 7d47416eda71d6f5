# SPDX-License-Identifier: Apache-2.0
"""`run` and `replay` as a person calls them: processes of their own, over real DDS."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scene_recordings import SceneRecordingConfig, record_scenes
from websocket_client import WebSocketClient

from foretouch.cloud.io.files import write_cloud
from foretouch.simulation.depth_scene import random_scene

pytestmark = pytest.mark.ros

LISTENER = Path(__file__).parents[2] / "examples" / "listen_touch.py"


def _run(environment: dict[str, str], *words: object) -> tuple[int, list[dict[str, Any]], str]:
    done = subprocess.run(
        [sys.executable, "-m", "foretouch.cli.main", *map(str, words)],
        capture_output=True,
        text=True,
        env=environment,
        timeout=100,
        check=False,
    )
    return done.returncode, [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")], done.stderr


def test_a_recording_is_answered_cloud_by_cloud_and_drawn(tmp_path: Path, environment: dict[str, str]) -> None:
    record_scenes(tmp_path / "recording", SceneRecordingConfig(count=5))
    picture = tmp_path / "touch.png"
    status, lines, err = _run(environment, "run", "--source", tmp_path / "recording", "--json", "--picture", picture)
    assert status == 0, err
    *answers, last = lines
    assert (last["played"], last["answered"], len(answers)) == (5, 5, 5)
    assert last["conflicts"] == []
    assert "second graph" not in err
    assert len({answer["stamp_ns"] for answer in answers}) == 5
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_a_folder_is_played_once_in_order_with_stamps_of_its_own(tmp_path: Path, environment: dict[str, str]) -> None:
    for k in range(3):
        image = random_scene(np.random.default_rng(k), width=212, height=120, n_objects=1).render()
        write_cloud(tmp_path / f"{k + 8}.npz", image.cloud())
    status, lines, err = _run(environment, "run", "--source", tmp_path, "--json")
    assert status == 0, err
    stamps = [line["stamp_ns"] for line in lines[:-1]]
    assert len(stamps) == 3
    assert stamps == sorted(set(stamps))


def test_a_planner_that_is_waited_for_gets_every_answer(tmp_path: Path, environment: dict[str, str]) -> None:
    record_scenes(tmp_path / "recording", SceneRecordingConfig(count=5))
    command = ["run", "--source", str(tmp_path / "recording"), "--json", "--wait-for", "touch", "--wait-limit", "60"]
    with subprocess.Popen(
        [sys.executable, "-m", "foretouch.cli.main", *command],
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        listener = subprocess.run(
            [sys.executable, str(LISTENER), "--count", "5"],
            env=environment,
            capture_output=True,
            text=True,
            timeout=80,
            check=False,
        )
        out, err = process.communicate(timeout=60)
    assert process.returncode == 0, err
    stamps = [json.loads(line)["stamp_ns"] for line in out.splitlines()[:5]]
    heard = [line.split()[0].split(".") for line in listener.stdout.splitlines()]
    assert list(dict.fromkeys(int(sec) * 10**9 + int(ns) for sec, ns in heard)) == stamps


@pytest.mark.parametrize("source", ["camera", "scene.yaml"])
def test_a_camera_does_not_wait_for_subscribers(source: str, environment: dict[str, str]) -> None:
    status, _, err = _run(environment, "run", "--source", source, "--wait-for", "touch")
    assert status == 1
    assert err.splitlines() == [
        f"foretouch: --source {source}: a camera does not wait; --wait-for needs a recording or files"
    ]


def test_an_absent_source_is_one_line(tmp_path: Path, environment: dict[str, str]) -> None:
    status, lines, err = _run(environment, "run", "--source", tmp_path / "none", "--json")
    assert status == 1
    assert lines == []
    assert err.splitlines() == [f"foretouch: {tmp_path / 'none'}: does not exist"]


def test_an_absent_model_is_one_line_before_anything_starts(tmp_path: Path, environment: dict[str, str]) -> None:
    write_cloud(tmp_path / "8.npz", random_scene(np.random.default_rng(0), width=212, height=120).render().cloud())
    for model, rule in (("nope", "is no run folder, no card"), (tmp_path / "absent.json", "no such model card")):
        status, lines, err = _run(environment, "run", "--source", tmp_path / "8.npz", "--model", model, "--json")
        assert (status, lines) == (1, [])
        assert err.startswith(f"foretouch: {model}: {rule}"), err
        assert len(err.splitlines()) == 1


def test_an_absent_recording_is_one_line(tmp_path: Path, environment: dict[str, str]) -> None:
    status, lines, err = _run(environment, "replay", tmp_path / "none", "--json")
    assert (status, lines) == (1, [])
    assert err.splitlines() == [f"foretouch: {tmp_path / 'none'}: does not exist"]


def test_a_scene_is_seen_grasped_and_drawn_until_enough_is_answered(
    tmp_path: Path, environment: dict[str, str]
) -> None:
    scene, picture = tmp_path / "scene.yaml", tmp_path / "touch.png"
    scene.write_text("camera: {width: 424, height: 320}\ngrasps: {insertion_m: 0.01}\n", encoding="utf-8")
    options = ("--count", 10, "--json", "--picture", picture)
    status, lines, err = _run(environment, "run", "--source", scene, *options)
    assert status == 0, err
    *answers, last = lines
    assert 10 <= last["answered"] == len(answers) <= 15
    assert last["executed"]["success"] >= 1
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_a_mistake_in_a_scene_is_one_line(tmp_path: Path, environment: dict[str, str]) -> None:
    scene = tmp_path / "scene.yaml"
    scene.write_text("camera: {width: 424, hight: 320}\n", encoding="utf-8")
    status, lines, err = _run(environment, "run", "--source", scene, "--json")
    assert (status, lines) == (1, [])
    assert err.startswith(f"foretouch: {scene}: camera.hight: unknown setting")
    assert len(err.splitlines()) == 1


def test_a_recording_may_be_left_before_its_end(tmp_path: Path, environment: dict[str, str]) -> None:
    record_scenes(tmp_path / "recording", SceneRecordingConfig(count=100))
    status, lines, err = _run(environment, "run", "--source", tmp_path / "recording", "--json", "--count", 5)
    assert status == 0, err
    assert 5 <= lines[-1]["answered"] < 50


def test_ctrl_c_ends_it_cleanly(tmp_path: Path, environment: dict[str, str]) -> None:
    record_scenes(tmp_path / "recording", SceneRecordingConfig(count=200))
    with subprocess.Popen(
        [sys.executable, "-m", "foretouch.cli.main", "run", "--source", str(tmp_path / "recording"), "--json"],
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdout is not None
        process.stdout.readline()  # the first answer: it is under way
        time.sleep(0.5)
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=30)
    last = json.loads(out.splitlines()[-1])
    assert process.returncode == 0, err
    assert 0 < last["answered"] < 200
    assert "Traceback" not in err


@pytest.mark.parametrize("command", [("run", "--source", "clouds"), ("replay", "clouds")])
def test_a_plane_that_is_not_four_numbers_is_wrong_usage(command: tuple[str, ...], environment: dict[str, str]) -> None:
    status, _, err = _run(environment, *command, "--plane", "0,0,1")
    assert status == 2
    assert "argument --plane" in err
    assert "Traceback" not in err


def test_without_a_camera_it_says_what_it_waits_for_and_ends_with_a_status_of_its_own(
    environment: dict[str, str],
) -> None:
    process = subprocess.Popen(
        [sys.executable, "-m", "foretouch.cli.main", "run", "--source", "camera", "--json"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=environment,
    )
    assert process.stderr is not None
    lines = []
    for line in process.stderr:
        lines.append(line)
        if "waiting for the first cloud" in line:
            break
    process.send_signal(signal.SIGINT)
    _, rest = process.communicate(timeout=60)
    assert process.returncode == 3, rest
    assert "no RealSense device" in lines[-1], lines
    assert "no cloud came from the camera" in rest
    assert "Traceback" not in "".join(lines) + rest


def test_serve_gives_the_answers_to_a_websocket_client(tmp_path: Path, environment: dict[str, str]) -> None:
    pytest.importorskip("foxglove", reason="the Foxglove SDK is not installed: pip install 'foretouch[serve]'")
    for k in range(40):
        image = random_scene(np.random.default_rng(k % 2), width=212, height=120, n_objects=1).render()
        write_cloud(tmp_path / f"{k + 10}.npz", image.cloud())
    words = ("run", "--source", tmp_path, "--rate", 5, "--serve", "127.0.0.1:0", "--json")
    command = [sys.executable, "-m", "foretouch.cli.main", *map(str, words)]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment
    ) as process:
        assert process.stderr is not None
        line = next(line for line in process.stderr if "serving at ws://127.0.0.1:" in line and "open it" in line)
        with WebSocketClient(line.split()[3].rstrip(":")) as client:
            client.subscribe("/foretouch/touch")
            assert client.next_data().topic == "/foretouch/touch"
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=60)
    assert "Traceback" not in err


@pytest.mark.parametrize("address", ["8765", "localhost:", "127.0.0.1:99999", "127.0.0.1:x"])
def test_an_address_to_serve_at_is_checked(address: str, environment: dict[str, str]) -> None:
    status, _, err = _run(environment, "run", "--source", "none", "--serve", address)
    assert status == 2
    assert f"{address!r} is not HOST:PORT, such as 127.0.0.1:8765" in err
