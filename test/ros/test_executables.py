# SPDX-License-Identifier: Apache-2.0
"""Nodes as processes of their own, as a launch file starts them."""

import ast
import signal
from pathlib import Path

import pytest
from every_case import every_case
from sensor_msgs.msg import PointCloud2

from foretouch.ros import executables
from foretouch.ros.messages.clouds import cloud_to_msg
from foretouch.ros.nodes import NODES
from foretouch.types import stamp_ns
from foretouch_msgs.msg import TouchPredictionArray

pytestmark = pytest.mark.ros


def test_one_table_lists_the_executables_of_the_package_and_of_setup():
    (names,) = [
        ast.literal_eval(line.value)
        for line in ast.parse((Path(__file__).parents[2] / "setup.py").read_text(encoding="utf-8")).body
        if isinstance(line, ast.Assign) and line.targets[0].id == "NODES"
    ]
    assert set(names) == set(NODES)
    for name in names:
        entry_point = getattr(executables, name)
        assert (entry_point.func, entry_point.args) == (executables.run, (name,))


def test_each_executable_answers_help_and_refuses_what_is_not_for_ros(capsys):
    def check(name):
        for word, status, text in (("--help", 0, "--params-file FILE"), ("--nonsense", 2, "arguments: --nonsense")):
            with pytest.raises(SystemExit) as ended:
                getattr(executables, name)(args=["x", word, "--ros-args", "-p", "a:=1"])
            printed = " ".join("".join(capsys.readouterr()).split())
            assert (ended.value.code, text in printed, f"usage: foretouch_{name}" in printed) == (status, True, True)

    every_case([(name,) for name in NODES], check)


@pytest.mark.slow
def test_three_processes_make_one_chain_and_end_cleanly_on_ctrl_c(lone_graph, scene_cloud, model_card):
    graph = lone_graph
    arguments = {
        "segmentation": ("-p", "input:=points"),
        "grasp": (),
        "touch_predictor": ("-p", f"model:={model_card}"),
    }
    processes = {name: graph.start(name, *words) for name, words in arguments.items()}
    heard, publisher = graph.listen(TouchPredictionArray, "touch"), graph.talk(PointCloud2, "points")
    graph.matched("points", "grasps", "touch")
    graph.matched("table", "object_cloud", subscribers=2)
    stamps = [1_700_000_000_000_000_000 + k for k in range(5)]
    for k, stamp in enumerate(stamps, 1):
        publisher.publish(cloud_to_msg(scene_cloud(k, stamp_ns=stamp)))
        graph.until(lambda wanted=k: len(heard) >= wanted)
    assert [stamp_ns(message.header.stamp) for message in heard] == stamps
    assert [(message.reason, [prediction.model for prediction in message.predictions[:1]]) for message in heard] == [
        ("", ["small"])
    ] * len(stamps)
    for process in processes.values():
        process.send_signal(signal.SIGINT)
    for name, process in processes.items():
        _, stderr = process.communicate(timeout=20)
        assert (process.returncode, "Traceback" in stderr) == (0, False), (name, stderr)


@pytest.mark.slow
def test_namespace_and_topics_can_be_remapped(lone_graph, scene_cloud):
    graph = lone_graph
    remapped = ("-r", "__ns:=/left", "-r", "points:=/camera/points", "-p", "input:=points")
    process = graph.start("segmentation", *remapped)
    heard, publisher = graph.listen(PointCloud2, "/left/object_cloud"), graph.talk(PointCloud2, "/camera/points")
    graph.matched("/camera/points", "/left/object_cloud")
    publisher.publish(cloud_to_msg(scene_cloud()))
    graph.until(lambda: heard)
    assert heard[0].width > 0
    process.send_signal(signal.SIGTERM)
    process.communicate(timeout=20)


@pytest.mark.slow
def test_a_start_that_must_fail_is_one_line_and_exit_1(lone_graph):
    for name, parameter, message in (
        ("segmentation", "--nonsense", "foretouch: ROS arguments: unknown: ['--nonsense']"),
        ("segmentation", "target.mode:=prettiest", "foretouch: target.mode: 'prettiest' is not one of nearest"),
        ("segmentation", "target.moed:=all", "target.moed: unknown parameter; did you mean target.mode?"),
        ("perception", "queue_depth:=4", "queue_depth: was removed in 0.4"),
        ("segmentation", "silence_s:=many", "foretouch: silence_s"),
        ("replay", "path:=/nope", "[foretouch.replay]: /nope: does not exist"),
    ):
        process = lone_graph.start(name, *(("-p", parameter) if ":=" in parameter else (parameter,)))
        _, stderr = process.communicate(timeout=30)
        assert process.returncode == 1
        (line,) = stderr.strip().splitlines()
        assert message in line
