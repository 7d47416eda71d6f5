# SPDX-License-Identifier: Apache-2.0
"""`foretouch record --check` beside a simulated hand and camera: what is wrong is named, and stored with the dataset."""

import json
import re
import subprocess
import sys
import time
from pathlib import Path

import pytest
from process_domain import process_environment
from sim_builders import CAN, SHORT, scene

from foretouch.ros.sessions.check import CHECKS

pytest.importorskip("libusb_package", reason="the camera's libraries are not installed")
pytestmark = [pytest.mark.ros, pytest.mark.slow]

ROOT = Path(__file__).parents[2]
OF_LOAD = {"hand rate", "hand clock", "camera clock"}
"""What a computer may have that is too slow for the simulated camera and hand."""


def test_swapped_and_frozen_fingers_a_clock_offset_and_a_slow_camera_are_named(lone_graph, tmp_path):
    config = scene(CAN, camera={"width": 424, "height": 320}, fingers={"noise": {}})
    (tmp_path / "scene.yaml").write_text(json.dumps(config.to_mapping()), encoding="utf-8")
    show = {"scene__path": str(tmp_path / "scene.yaml"), "scene__dwell_s": 600.0, "scene__origin_ns": time.time_ns()}
    lone_graph.add("segmentation", "grasp")
    (hand,) = lone_graph.add("hand", automatic=False, faults__swapped=True, faults__skew_s=0.2, **show, **SHORT)
    lone_graph.add("camera", source="scene", camera__fps=5, **show)

    def check():
        command = [sys.executable, "-m", "foretouch", "record", "-o", str(tmp_path / "set"), "--check", "--json"]
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
        with subprocess.Popen(command, env=lone_graph.environment(), **pipes) as process:
            told = [line for line in process.stderr if "presses its" in line]
            found = [json.loads(line) for line in process.stdout]
        assert process.wait() == 1
        assert [line.split("presses its ")[1].split()[0] for line in told] == ["thumb", "middle"]
        return {one["name"]: f"{one['found']}; {one['fix']}" for one in found if one["fault"]}

    found = check()
    wanted = {"hand clock", "camera rate", "press thumb", "press middle finger"}
    assert wanted <= found.keys() <= wanted | OF_LOAD, found
    assert "ahead of this computer" in found["hand clock"]
    assert "at least 10 are needed" in found["camera rate"]
    assert found["press thumb"] == "MF answered; fingers are swapped: --thumb MF --middle TH"
    lone_graph.set(hand, faults__swapped=False, faults__skew_s=0.0, faults__frozen="MF")
    found = check()
    wanted = {"middle finger", "camera rate", "press middle finger"}
    assert wanted <= found.keys() <= wanted | OF_LOAD, found
    assert found["middle finger"].startswith("frozen: the same ")
    reports = [json.loads(line) for line in (tmp_path / "set" / CHECKS).read_text().splitlines()]
    last = {one["name"]: f"{one['found']}; {one['fix']}" for one in reports[1]["findings"] if one["fault"]}
    assert (len(reports), last) == (2, found)


def test_the_check_of_the_page_finds_no_fault_of_the_simulated_hand(tmp_path):
    page = (ROOT / "docs" / "recording.md").read_text(encoding="utf-8")
    commands = re.search(r"On the simulated hand.*?```sh\n(.*?)```", page, re.DOTALL)[1]
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    command = tmp_path / "bin" / "foretouch"
    command.parent.mkdir()
    command.write_text(f'#!/bin/sh\nexec {sys.executable} -m foretouch "$@"\n', encoding="utf-8")
    command.chmod(0o755)
    environment = process_environment()
    environment["PATH"] = f"{command.parent}:{environment['PATH']}"
    done = subprocess.run(
        ["bash", "-c", commands],
        check=False,
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        timeout=120,
    )
    faults = [line for line in done.stdout.splitlines() if line.startswith("FAULT")]
    assert "ok    press thumb: TH answered" in done.stdout, done
    assert "ok    press middle finger: MF answered" in done.stdout
    assert "ok    recorded as: hand unknown, camera unknown (--set identity.hand=NAME" in done.stdout
    assert all(line.split(":")[0].removeprefix("FAULT ") in OF_LOAD | {"camera rate"} for line in faults), faults
