# SPDX-License-Identifier: Apache-2.0
"""The launch files: with stubs of `launch` everywhere, and with `launch` itself where a full ROS 2 is installed."""

import importlib.util
import re
import sys
from pathlib import Path
from types import SimpleNamespace

import launch_stubs
import pytest
from every_case import every_case

from foretouch.cloud.io.files import write_cloud
from foretouch.pipeline import Pipeline
from foretouch.ros.nodes.recorder import RecorderConfig

FOLDER = Path(__file__).parents[2] / "launch"
SHOWN = ["-p", "scene.path:=s.yaml", "-p", "scene.dwell_s:=2.0"]
MODEL = ["-p", "model:=m.json", "-p", "predictor:=mine:Mine"]
SHARED = {"namespace": "/left", "predictor": "", "params_file": "", "use_sim_time": "false", "respawn": "false"}
NODES = {  # values of the arguments, then executables with what is peculiar to each
    "camera": ({}, {"camera": {}}),
    "perception": (
        {
            "points": "/camera/points",
            "depth": "d",
            "color": "c",
            "model": "m.json",
            "predictor": "mine:Mine",
            "one_process": "true",
            "input": "",
        },
        {
            "perception": {
                "remappings": [("depth/image", "d"), ("color/image", "c"), ("points", "/camera/points")],
                "ros_arguments": [*MODEL, "-p", "input:=points"],
            }
        },
    ),
    "recorder": (
        {"record": "", "object": "7", "folder": "", "tactile": "", "tactile_type": ""},
        {"recorder": {"parameters": [{"object": "7"}]}},
    ),
    "scene": (
        {"scene": "s.yaml", "dwell": "2", "fps": "4"},
        {
            "hand": {"ros_arguments": SHOWN},
            "camera": {"ros_arguments": [*SHOWN, "-p", "source:=scene", "-p", "camera.fps:=4"]},
        },
    ),
}


@pytest.fixture(params=["stubs", "launch"], autouse=True)
def library(request, monkeypatch):
    """Which `launch` the files are read with; the helper module is read anew for each."""
    if request.param == "stubs":
        launch_stubs.install(monkeypatch)
    else:
        for module in ("launch", "launch_ros.actions"):
            pytest.importorskip(module, reason="launch comes with a full ROS 2 install only")
    monkeypatch.setattr(sys, "path", list(sys.path))
    monkeypatch.delitem(sys.modules, "foretouch_launch_helpers", raising=False)
    return request.param


def describe(name, **values):
    """The module of a launch file, its description, and a context with values of its arguments."""
    from launch import LaunchContext

    spec = importlib.util.spec_from_file_location(name, FOLDER / f"{name}.launch.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    context = LaunchContext()
    context.launch_configurations.update({**SHARED, **values})
    return module, module.generate_launch_description(), context


def test_each_node_gets_namespace_parameter_file_and_arguments(library):
    for name, (values, expected) in NODES.items():
        module, description, context = describe(name, **values, params_file="d415.yaml")
        assert description.entities
        assert all(argument.description for argument in module.ARGUMENTS)
        nodes = getattr(module, name)(context)
        assert [node.node_executable for node in nodes] == [f"foretouch_{executable}" for executable in expected]
        for node, own in zip(nodes, expected.values(), strict=True) if library == "stubs" else ():
            options = dict(node.options)
            assert options.pop("on_exit").__name__ == "end_with_node"
            assert options.pop("namespace").perform(context) == "/left"
            wanted = {"package": "foretouch", "executable": node.node_executable, "output": "screen", **own}
            wanted["parameters"] = ["d415.yaml", *own.get("parameters", [])]
            assert {key: value for key, value in options.items() if value != []} == wanted
    module, _, context = describe(
        "perception", points="", depth="/depth/image_raw", color="", model="m.json", one_process="false", input=""
    )
    nodes = {node.node_executable: node for node in module.perception(context)}
    assert list(nodes) == ["foretouch_segmentation", "foretouch_grasp", "foretouch_touch_predictor"]
    if library == "stubs":
        options = nodes["foretouch_segmentation"].options
        assert (options["remappings"], options["ros_arguments"]) == (
            [("depth/image", "/depth/image_raw")],
            ["-p", "input:=depth"],
        )
    for name in ("camera", "replay"):
        module, _, context = describe(name, path="p.mcap", use_sim_time="true", respawn="true")
        (node,) = getattr(module, name)(context)
        if library == "stubs":  # a replay ends by itself
            assert node.options["parameters"] == [{"use_sim_time": True}]
            assert ("respawn" in node.options, "on_exit" in node.options) == (name == "camera", name == "replay")
    module, *_ = describe("recorder")
    known = {*RecorderConfig().to_mapping(), *(f"tactile.{name}" for name in RecorderConfig().tactile.to_mapping())}
    assert set(module.PARAMETERS.values()) <= known


def test_a_file_with_its_own_source_of_clouds_includes_the_rest_without_a_camera(library, tmp_path, scene_cloud):
    scene, target = tmp_path / "scene", tmp_path / "target"
    for folder, cloud in ((scene, scene_cloud()), (target, Pipeline().segment(scene_cloud()).targets[0].cloud)):
        folder.mkdir()
        write_cloud(folder / "1.pcd", cloud)
    for name, path, kind in (("replay", scene, "points"), ("replay", target, "objects"), ("scene", scene, None)):
        module, description, context = describe(name, path=str(path), model="m.json", rviz="true")
        if library != "stubs":
            continue
        included = description.entities[len(module.ARGUMENTS) + 1]
        (included,) = included.function(context) if name == "replay" else (included,)
        assert included.source.parts[1:] == ["launch", "perception.launch.py"]
        given = {key: getattr(one, "perform", lambda _, v=one: v)(context) for key, one in included.launch_arguments}
        own = {"camera": "false", **SHARED, **({"input": kind} if kind else {})}
        assert given == {**own, "model": "m.json", "rviz": "true"}


def test_a_wrong_argument_is_refused_before_anything_is_started_and_a_launch_fails_with_a_node(library, monkeypatch):
    monkeypatch.setenv("AMENT_PREFIX_PATH", sys.prefix)  # where there is no rviz2

    def check(message, name, values):
        module, description, context = describe(name, **values)
        first = description.entities[len(module.ARGUMENTS)]
        with pytest.raises(Exception, match=re.escape(message)):
            first.function(context) if library == "stubs" else first.execute(context)

    cases = [
        ("path: /nope does not exist", "replay", {"path": "/nope"}),
        ("params_file: /nope.yaml does not exist", "camera", {"params_file": "/nope.yaml"}),
        ("rviz: the package rviz2 is not installed", "perception", {"rviz": "true"}),
        ("nope: is not a model folder, no card", "perception", {"model": "nope"}),
    ]
    every_case(cases, check)
    end_with_node = sys.modules["foretouch_launch_helpers"].end_with_node
    ended, failed = (SimpleNamespace(returncode=code, process_name="replay-1") for code in (0, 1))
    assert end_with_node(ended, SimpleNamespace(is_shutdown=False)) is not None
    with pytest.raises(RuntimeError, match="replay-1 ended with exit status 1"):
        end_with_node(failed, SimpleNamespace(is_shutdown=False))
    assert end_with_node(failed, SimpleNamespace(is_shutdown=True)) is not None
