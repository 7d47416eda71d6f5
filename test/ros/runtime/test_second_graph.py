# SPDX-License-Identifier: Apache-2.0
"""Two graphs in one namespace over real DDS: both name what is there twice."""

import json
import signal
import subprocess
import sys

import pytest
from diagnostic_msgs.msg import DiagnosticStatus

from foretouch.dataset.bag_writer import write_bag
from foretouch.ros.executables import PERCEPTION
from foretouch_msgs.msg import TouchPredictionArray

pytestmark = pytest.mark.ros

SEGMENTATION = "2 nodes are named /foretouch/segmentation"


def foretouch(graph, *words):
    """The last line of a command's JSON, and what it wrote to stderr."""
    command = [sys.executable, "-m", "foretouch.cli.main", *map(str, words), "--json"]
    done = subprocess.run(command, env=graph.environment(), capture_output=True, text=True, timeout=60, check=False)
    assert "Traceback" not in done.stderr
    return json.loads(done.stdout.splitlines()[-1]), done.stderr


@pytest.fixture
def recording(tmp_path, scene_cloud):
    write_bag(tmp_path / "recording", [scene_cloud(stamp_ns=stamp, width=212) for stamp in (1, 2)])
    return tmp_path / "recording"


def test_answers_of_a_node_of_another_name_are_reported(graph):
    node, touch = graph.add("segmentation", "touch_predictor", model="none")
    publisher = graph.talk(TouchPredictionArray, "touch")
    text = "/foretouch/touch has 2 publishers: /foretouch/probe, /foretouch/touch_predictor"
    graph.until(lambda: touch.conflicts == (text,))
    assert node.conflicts == ()
    graph.probe.destroy_publisher(publisher)
    graph.until(lambda: touch.conflicts == ())


@pytest.mark.slow
def test_nodes_of_the_same_name_are_reported_by_both_and_forgotten_when_one_ends(lone_graph):
    graph = lone_graph
    (node,) = graph.add("segmentation", diagnostics_period_s=0.1)
    reports = graph.reports("segmentation")
    graph.until(lambda: reports)
    assert (node.conflicts, reports[-1].level) == ((), DiagnosticStatus.WARN)  # no input yet
    other = graph.start("segmentation", "-p", "diagnostics_period_s:=0.1")
    graph.until(lambda: node.conflicts == (SEGMENTATION,))
    graph.until(lambda: SEGMENTATION in reports[-1].message)
    assert reports[-1].level == DiagnosticStatus.WARN
    line = other.stderr.readline()
    assert f"a second graph or source runs in /foretouch: {SEGMENTATION}" in line
    other.send_signal(signal.SIGINT)
    _, logged = other.communicate(timeout=20)
    assert (other.returncode, logged.count("a second graph")) == (0, 0)  # once was enough
    graph.until(lambda: node.conflicts == ())
    del reports[:]
    graph.until(lambda: reports)
    assert SEGMENTATION not in reports[-1].message


@pytest.mark.slow
def test_replay_and_run_print_that_another_graph_answers_too(lone_graph, recording, model_card):
    graph = lone_graph
    graph.add(*PERCEPTION, model=model_card)
    counts, printed = foretouch(graph, "run", "--source", recording, "--model", model_card)
    assert counts["answered"] > counts["played"] == 2
    line = next(line for line in printed.splitlines() if line.startswith("foretouch: a second graph"))
    for name in PERCEPTION:
        assert f"2 nodes are named /foretouch/{name}" in line
        assert f"2 nodes are named /foretouch/{name}" in counts["conflicts"]
    graph.start("segmentation", "-p", "diagnostics_period_s:=1.0")
    graph.until(lambda: graph.probe.count_publishers("/foretouch/objects") == 2)
    counts, printed = foretouch(graph, "replay", recording, "--restamp")
    text = "/foretouch/objects has 2 publishers: /foretouch/segmentation, /foretouch/segmentation"
    assert (counts["clouds"], counts["conflicts"]) == (2, [text])
    assert f"foretouch: a second graph or source runs in the namespace: {text}" in printed.splitlines()
