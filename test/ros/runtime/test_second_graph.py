# SPDX-License-Identifier: Apache-2.0
"""Two graphs in one namespace, in processes of their own over real DDS: both say so by name."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from recording_builders import SceneRecordingConfig, record_scenes

from foretouch.ros.executables import PERCEPTION
from foretouch_msgs.msg import TouchPredictionArray

pytestmark = pytest.mark.ros

SMALL = SceneRecordingConfig(count=2, width=212, height=120)
SEGMENTATION = "2 nodes are named /foretouch/segmentation"


@pytest.fixture
def start(graph: Any, tmp_path: Path) -> Iterator[Callable[..., subprocess.Popen[bytes]]]:
    """Starts an executable of the package in a process of its own, in the namespace of the graph; it logs to `log`."""
    running = []

    def run(name: str, *ros_arguments: str) -> subprocess.Popen[bytes]:
        code = f"import sys; from foretouch.ros.executables import {name}; sys.exit({name}())"
        command = [sys.executable, "-c", code, "--ros-args", *ros_arguments]
        environment = {**os.environ, "ROS_DOMAIN_ID": str(graph.domain)}
        with (tmp_path / "log").open("wb") as log:
            running.append(subprocess.Popen(command, env=environment, stderr=log))
        return running[-1]

    yield run
    for process in running:
        process.kill()
        process.wait(timeout=10)


def call(graph: Any, *words: object) -> tuple[dict[str, Any], str]:
    """The last line of a command's JSON, and what it wrote to stderr."""
    environment = {**os.environ, "ROS_DOMAIN_ID": str(graph.domain)}
    command = [sys.executable, "-m", "foretouch.cli.main", *map(str, words), "--json"]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=60, check=False)
    assert "Traceback" not in done.stderr
    return json.loads(done.stdout.splitlines()[-1]), done.stderr


def test_nodes_of_the_same_name_are_reported_by_both_and_forgotten_when_one_ends(
    graph: Any, start: Any, tmp_path: Path
) -> None:
    (node,) = graph.add("segmentation", diagnostics_period_s=0.1)
    reports = graph.listen(DiagnosticArray, "/diagnostics")
    graph.until(lambda: reports)
    assert (node.conflicts, reports[-1].status[0].level) == ((), DiagnosticStatus.WARN)  # no input yet
    other = start("segmentation", "-p", "diagnostics_period_s:=0.1")

    graph.until(lambda: node.conflicts == (SEGMENTATION,))
    graph.until(lambda: "a second graph" in (tmp_path / "log").read_text())
    graph.until(lambda: SEGMENTATION in reports[-1].status[0].message)
    assert reports[-1].status[0].level == DiagnosticStatus.WARN
    other.send_signal(signal.SIGINT)
    assert other.wait(timeout=20) == 0
    said = (tmp_path / "log").read_text()
    assert said.count("a second graph") == 1
    assert f"a second graph or source runs in /foretouch: {SEGMENTATION}" in said
    graph.until(lambda: node.conflicts == ())
    del reports[:]
    graph.until(lambda: reports)
    assert SEGMENTATION not in reports[-1].status[0].message


def test_answers_of_a_node_of_another_name_are_reported(graph: Any) -> None:
    (node,) = graph.add("segmentation")
    (touch,) = graph.add("touch_predictor", model="none")
    publisher = graph.talk(TouchPredictionArray, "touch")
    text = "/foretouch/touch has 2 publishers: /foretouch/probe, /foretouch/touch_predictor"
    graph.until(lambda: touch.conflicts == (text,))
    assert node.conflicts == ()
    graph.probe.destroy_publisher(publisher)
    graph.until(lambda: touch.conflicts == ())


def test_replay_says_in_its_output_that_two_graphs_will_answer(graph: Any, start: Any, tmp_path: Path) -> None:
    record_scenes(tmp_path / "recording", SMALL)
    graph.add("segmentation")
    start("segmentation")
    graph.until(lambda: graph.probe.count_publishers("/foretouch/objects") == 2)
    counts, said = call(graph, "replay", tmp_path / "recording", "--restamp")
    text = "/foretouch/objects has 2 publishers: /foretouch/segmentation, /foretouch/segmentation"
    assert (counts["clouds"], counts["conflicts"]) == (2, [text])
    assert f"foretouch: a second graph or source runs in the namespace: {text}" in said.splitlines()


@pytest.mark.slow
def test_run_says_in_its_output_that_another_graph_answers_too(graph: Any, model_card: str, tmp_path: Path) -> None:
    record_scenes(tmp_path / "recording", SMALL)
    graph.add(*PERCEPTION, model=model_card)
    counts, said = call(graph, "run", "--source", tmp_path / "recording", "--model", model_card)
    assert counts["answered"] > counts["played"] == 2
    line = next(line for line in said.splitlines() if line.startswith("foretouch: a second graph"))
    for name in PERCEPTION:
        assert f"2 nodes are named /foretouch/{name}" in line
        assert f"2 nodes are named /foretouch/{name}" in counts["conflicts"]
