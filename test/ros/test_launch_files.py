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

from foretouch.ros.nodes.recorder import RecorderConfig

FOLDER = Path(__file__).parents[2] / "launch"
ARGUMENTS = {
    "perception": {"namespace", "camera", "points", "model", "params_file", "one_process", "rviz"},
    "camera": {"namespace", "params_file"},
    "replay": {"path", "namespace", "model", "params_file", "rviz"},
    "recorder": {"record", "object", "folder", "tactile", "tactile_type", "namespace", "params_file"},
    "scene": {"scene", "dwell", "fps", "namespace", "model", "params_file", "rviz"},
}
SHOWN = ["-p", "scene.path:=s.yaml", "-p", "scene.dwell_s:=2.0"]
NODES = {  # values of the arguments, then executables with what is peculiar to each
    "camera": ({}, {"camera": {}}),
    "perception": (
        {"points": "/camera/points", "model": "m.json", "one_process": "true"},
        {"perception": {"remappings": [("points", "/camera/points")], "ros_arguments": ["-p", "model:=m.json"]}},
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
    context.launch_configurations.update({"namespace": "/left", "params_file": "", **values})
    return module, module.generate_launch_description(), context


def test_arguments_are_few_named_and_described():
    for name, arguments in ARGUMENTS.items():
        module, description, _ = describe(name)
        assert sorted(argument.name for argument in module.ARGUMENTS) == sorted(arguments)
        assert all(argument.description for argument in module.ARGUMENTS)
        assert description.entities
    module, *_ = describe("recorder")
    known = {*RecorderConfig().to_mapping(), *(f"tactile.{name}" for name in RecorderConfig().tactile.to_mapping())}
    assert set(module.PARAMETERS.values()) <= known
    assert module.DESCRIPTIONS.keys() == module.PARAMETERS.keys()


def test_each_node_gets_namespace_parameter_file_and_arguments(library):
    def check(name, params_file):
        values, expected = NODES[name]
        module, _, context = describe(name, **values, params_file=params_file)
        nodes = getattr(module, name)(context)
        assert [node.node_executable for node in nodes] == [f"foretouch_{executable}" for executable in expected]
        if library != "stubs":
            return  # what a node of launch_ros was given is its own affair
        for node, own in zip(nodes, expected.values(), strict=True):
            options = dict(node.options)
            assert options.pop("on_exit").__name__ == "end_with_node"
            assert options.pop("namespace").perform(context) == "/left"
            parameters = [*([params_file] if params_file else []), *own.get("parameters", [])]
            wanted = {"package": "foretouch", "executable": node.node_executable, "output": "screen", **own}
            wanted |= {"parameters": parameters} if parameters else {}
            assert {key: value for key, value in options.items() if value != []} == wanted

    every_case([(name, params_file) for name in NODES for params_file in ("", "d415.yaml")], check)
    module, _, context = describe("perception", points="points", model="m.json", one_process="false")
    nodes = {node.node_executable: node for node in module.perception(context)}
    assert list(nodes) == ["foretouch_segmentation", "foretouch_grasp", "foretouch_touch_predictor"]
    if library == "stubs":
        assert [node.options["ros_arguments"] for node in nodes.values()] == [[], [], ["-p", "model:=m.json"]]


def test_a_file_with_its_own_source_of_clouds_includes_the_rest_without_a_camera(library):
    for name in ("replay", "scene"):
        module, description, context = describe(name, path="recording/", model="m.json", rviz="true")
        if library != "stubs":
            continue
        included = description.entities[len(module.ARGUMENTS) + 1]
        assert included.source.parts[1:] == ["launch", "perception.launch.py"]
        given = {key: getattr(one, "perform", lambda _, v=one: v)(context) for key, one in included.launch_arguments}
        own = {"camera": "false", "namespace": "/left", "params_file": ""}
        assert given == {**own, "model": "m.json", "rviz": "true"}
    module, _, context = describe("replay", path="recording/")
    (node,) = module.replay(context)
    assert node.node_executable == "foretouch_replay"


def test_a_wrong_argument_is_refused_before_anything_is_started(library, monkeypatch):
    monkeypatch.setenv("AMENT_PREFIX_PATH", sys.prefix)  # where there is no rviz2

    def check(message, name, values):
        module, description, context = describe(name, **values)
        first = description.entities[len(module.ARGUMENTS)]
        with pytest.raises(Exception, match=re.escape(message)):
            first.function(context) if library == "stubs" else first.execute(context)

    cases = [
        ("path: /nope does not exist", "replay", {"path": "/nope"}),
        ("scene: /nope.yaml does not exist", "scene", {"scene": "/nope.yaml"}),
        ("params_file: /nope.yaml does not exist", "camera", {"params_file": "/nope.yaml"}),
        ("rviz: the package rviz2 is not installed", "perception", {"rviz": "true"}),
        ("nope: is not a model folder, no card", "perception", {"model": "nope"}),
        ("/nope.json: no such model card", "perception", {"model": "/nope.json"}),
    ]
    every_case(cases, check)


def test_a_launch_ends_with_a_node_and_fails_with_it():
    describe("replay", path="recording/")
    end_with_node = sys.modules["foretouch_launch_helpers"].end_with_node
    ended, failed = (SimpleNamespace(returncode=code, process_name="replay-1") for code in (0, 1))
    assert end_with_node(ended, SimpleNamespace(is_shutdown=False)) is not None
    with pytest.raises(RuntimeError, match="replay-1 ended with exit status 1"):
        end_with_node(failed, SimpleNamespace(is_shutdown=False))
    assert end_with_node(failed, SimpleNamespace(is_shutdown=True)) is not None
