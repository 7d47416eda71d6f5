# SPDX-License-Identifier: Apache-2.0
"""Nodes as processes of their own, as a launch file starts them."""

import ast
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from sensor_msgs.msg import PointCloud2

from foretouch.ros import executables
from foretouch.ros.messages.clouds import cloud_to_msg
from foretouch.tactile.messages.table import stamp_ns
from foretouch_msgs.msg import Status, TouchPredictionArray

pytestmark = [pytest.mark.ros, pytest.mark.slow]


def start(name, *ros_arguments, domain=1, **popen):
    code = f"import sys; from foretouch.ros.executables import {name}; sys.exit({name}())"
    command = [sys.executable, "-c", code, "--ros-args", *ros_arguments]
    environment = {**os.environ, "ROS_DOMAIN_ID": str(domain)}
    return subprocess.Popen(
        command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **popen
    )


def test_one_table_lists_the_executables_of_the_package_and_of_setup():
    (names,) = [
        ast.literal_eval(line.value)
        for line in ast.parse((Path(__file__).parents[2] / "setup.py").read_text(encoding="utf-8")).body
        if isinstance(line, ast.Assign) and line.targets[0].id == "NODES"
    ]
    assert set(names) == set(executables.EXECUTABLES)
    assert {name for nodes in executables.EXECUTABLES.values() for name in nodes} == set(executables.NODES)
    for name, nodes in executables.EXECUTABLES.items():
        entry_point = getattr(executables, name)
        assert (entry_point.func, entry_point.args) == (executables.run, nodes)
    with pytest.raises(AttributeError, match="no attribute 'toaster'"):
        executables.toaster  # noqa: B018


@pytest.fixture
def processes(graph):
    running = {}
    yield running
    for process in running.values():
        if process.poll() is None:
            process.kill()
        process.communicate(timeout=10)


def test_three_processes_make_one_chain_and_end_cleanly_on_ctrl_c(graph, processes, scene_cloud, model_card):
    processes["segmentation"] = start("segmentation", domain=graph.domain)
    processes["grasp"] = start("grasp", domain=graph.domain)
    processes["touch"] = start("touch_predictor", "-p", f"model:={model_card}", domain=graph.domain)
    heard = graph.listen(TouchPredictionArray, "touch")
    publisher = graph.talk(PointCloud2, "points")
    for topic, ends in {
        "points": (1, 1),
        "table": (1, 2),
        "object_cloud": (1, 2),
        "grasps": (1, 1),
        "touch": (1, 1),
    }.items():
        graph.matched(topic, *ends)
    stamps = [1_700_000_000_000_000_000 + k for k in range(5)]
    for k, stamp in enumerate(stamps):
        publisher.publish(cloud_to_msg(scene_cloud(k, stamp_ns=stamp)))
        graph.until(lambda wanted=k + 1: len(heard) >= wanted)
    assert [stamp_ns(message.header.stamp) for message in heard] == stamps
    assert all(message.predictions[0].model == "small" for message in heard)
    for process in processes.values():
        process.send_signal(signal.SIGINT)
    for name, process in processes.items():
        _, stderr = process.communicate(timeout=20)
        assert process.returncode == 0, (name, stderr)
        assert "Traceback" not in stderr, (name, stderr)


def test_namespace_and_topics_can_be_remapped(graph, processes, scene_cloud):
    processes["segmentation"] = start(
        "segmentation", "-r", "__ns:=/left", "-r", "points:=/camera/points", domain=graph.domain
    )
    heard = graph.listen(PointCloud2, "/left/object_cloud")
    publisher = graph.talk(PointCloud2, "/camera/points")
    graph.matched("/camera/points")
    graph.matched("/left/object_cloud")
    publisher.publish(cloud_to_msg(scene_cloud()))
    graph.until(lambda: heard)
    assert heard[0].width > 0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("-p", "target.mode:=prettiest"), "'prettiest' is none of nearest, largest, point, all"),
        (("-p", "queue_depth:=0"), "queue_depth"),
        (("-p", "queue_depth:=many"), "queue_depth"),
    ],
)
def test_a_bad_parameter_is_one_line_and_exit_1(graph, processes, arguments, message):
    processes["segmentation"] = start("segmentation", *arguments, domain=graph.domain)
    _, stderr = processes["segmentation"].communicate(timeout=30)
    assert processes["segmentation"].returncode == 1
    (line,) = stderr.strip().splitlines()
    assert line.startswith("foretouch: ")
    assert message in line


def test_a_replay_without_its_source_ends_with_exit_1(graph, processes):
    processes["replay"] = start("replay", "-p", "path:=/nope", domain=graph.domain)
    _, stderr = processes["replay"].communicate(timeout=30)
    assert processes["replay"].returncode == 1
    (line,) = stderr.strip().splitlines()
    assert line.endswith("[foretouch.replay]: /nope: does not exist")


def test_an_unknown_parameter_is_a_warning(graph, processes):
    processes["grasp"] = start("grasp", "-p", "grasp.tip_nm:=25.0", domain=graph.domain)
    graph.until(lambda: graph.probe.count_publishers("/foretouch/grasps"))
    processes["grasp"].send_signal(signal.SIGTERM)
    _, stderr = processes["grasp"].communicate(timeout=20)
    assert "parameter grasp.tip_nm: unknown to grasp" in stderr


def test_an_absent_model_is_told_and_every_cloud_still_answered(graph, processes, scene_cloud):
    processes["perception"] = start("perception", "-p", "model:=absent.json", domain=graph.domain)
    heard = graph.listen(TouchPredictionArray, "touch")
    publisher = graph.talk(PointCloud2, "points")
    graph.matched("points")
    graph.matched("touch")
    publisher.publish(cloud_to_msg(scene_cloud()))
    graph.until(lambda: heard)
    assert heard[0].status == Status.NO_MODEL
    assert "absent.json" in heard[0].reason
