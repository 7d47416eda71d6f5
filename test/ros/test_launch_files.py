# SPDX-License-Identifier: Apache-2.0
"""The launch files: with stubs of `launch` everywhere, and with `launch` itself where a full ROS 2 is installed."""

from __future__ import annotations

import importlib.util
import re
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import launch_stubs
import pytest

FOLDER = Path(__file__).parents[2] / "launch"
SHARED = {"namespace": "/left", "params_file": ""}
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
def library(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """Which `launch` the files are read with; the helper module is read anew for each."""
    if request.param == "stubs":
        launch_stubs.install(monkeypatch)
    else:
        for module in ("launch", "launch_ros.actions"):
            pytest.importorskip(module, reason="launch comes with a full ROS 2 install only")
    monkeypatch.setattr(sys, "path", list(sys.path))
    monkeypatch.delitem(sys.modules, "foretouch_launch_helpers", raising=False)
    return str(request.param)


def describe(name: str, **values: str) -> tuple[Any, Any, Any]:
    """The module of a launch file, its description, and a context with values of its arguments."""
    from launch import LaunchContext

    spec = importlib.util.spec_from_file_location(name, FOLDER / f"{name}.launch.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    context = LaunchContext()
    context.launch_configurations.update({**SHARED, **values})
    return module, module.generate_launch_description(), context


@pytest.mark.parametrize(
    ("name", "arguments"),
    [
        ("perception", {"namespace", "camera", "points", "model", "params_file", "one_process", "rviz"}),
        ("camera", {"namespace", "params_file"}),
        ("replay", {"path", "namespace", "model", "params_file", "rviz"}),
        ("recorder", {"record", "object", "folder", "tactile", "tactile_type", "namespace", "params_file"}),
        ("scene", {"scene", "dwell", "fps", "namespace", "model", "params_file", "rviz"}),
    ],
)
def test_arguments_are_few_named_and_described(name: str, arguments: set[str]) -> None:
    module, description, _ = describe(name)
    assert {argument.name for argument in module.ARGUMENTS} == arguments
    assert len(module.ARGUMENTS) == len(arguments)
    assert all(argument.description for argument in module.ARGUMENTS)
    assert description.entities


@pytest.mark.parametrize(("together", "executables"), [("true", 1), ("false", 3)])
def test_perception_is_one_process_or_three(together: str, executables: int) -> None:
    module, _, context = describe("perception", points="/camera/points", model="m.json", one_process=together)
    assert len(module.perception(context)) == executables


@pytest.mark.parametrize("name", NODES)
@pytest.mark.parametrize("params_file", ["", "d415.yaml"])
def test_each_node_gets_namespace_parameter_file_and_arguments(name: str, params_file: str, library: str) -> None:
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
        assert {key: value for key, value in options.items() if value != []} == {
            **wanted,
            **({"parameters": parameters} if parameters else {}),
        }


def test_the_model_goes_to_the_touch_predictor_only(library: str) -> None:
    module, _, context = describe("perception", points="points", model="m.json", one_process="false")
    if library == "stubs":
        given = {node.node_executable: node.options["ros_arguments"] for node in module.perception(context)}
        assert given == {
            "foretouch_segmentation": [],
            "foretouch_grasp": [],
            "foretouch_touch_predictor": ["-p", "model:=m.json"],
        }


@pytest.mark.parametrize("name", ["replay", "scene"])
def test_a_file_with_its_own_source_of_clouds_includes_the_rest_without_a_camera(name: str, library: str) -> None:
    module, description, context = describe(name, path="recording/", model="m.json", rviz="true")
    if library != "stubs":
        return
    included = description.entities[len(module.ARGUMENTS) + 1]
    assert included.source.parts[1:] == ["launch", "perception.launch.py"]
    values = {
        key: value if isinstance(value, str) else value.perform(context) for key, value in included.launch_arguments
    }
    assert values == {"camera": "false", "namespace": "/left", "params_file": "", "model": "m.json", "rviz": "true"}


def test_a_replay_plays_the_path() -> None:
    module, _, context = describe("replay", path="recording/")
    (node,) = module.replay(context)
    assert node.node_executable == "foretouch_replay"


@pytest.mark.parametrize(
    ("name", "values", "message"),
    [
        ("replay", {"path": "/nope"}, "path: /nope does not exist"),
        ("scene", {"scene": "/nope.yaml"}, "scene: /nope.yaml does not exist"),
        ("camera", {"params_file": "/nope.yaml"}, "params_file: /nope.yaml does not exist"),
        ("perception", {"rviz": "true"}, "rviz: the package rviz2 is not installed"),
        ("perception", {"model": "nope"}, "nope: is no run folder, no card"),
        ("perception", {"model": "/nope.json"}, "/nope.json: no such model card"),
    ],
)
def test_a_wrong_argument_is_refused_before_anything_is_started(
    name: str, values: dict[str, str], message: str, library: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    if library == "launch" and "rviz" in values:
        monkeypatch.setenv("AMENT_PREFIX_PATH", sys.prefix)  # where there is no rviz2
    module, description, context = describe(name, **values)
    first = description.entities[len(module.ARGUMENTS)]
    with pytest.raises(Exception, match=re.escape(message)):
        first.function(context) if library == "stubs" else first.execute(context)


def test_a_launch_ends_with_a_node_and_fails_with_it() -> None:
    describe("replay", path="recording/")
    end_with_node = sys.modules["foretouch_launch_helpers"].end_with_node
    ended = SimpleNamespace(returncode=0, process_name="replay-1")
    assert end_with_node(ended, SimpleNamespace(is_shutdown=False)) is not None
    failed = SimpleNamespace(returncode=1, process_name="replay-1")
    with pytest.raises(RuntimeError, match="replay-1 ended with exit status 1"):
        end_with_node(failed, SimpleNamespace(is_shutdown=False))
    assert end_with_node(failed, SimpleNamespace(is_shutdown=True)) is not None


def test_the_launch_file_of_the_recorder_names_parameters_that_it_has() -> None:
    from foretouch.ros.recorder.config import RecorderConfig

    module, _, _ = describe("recorder")
    known = {*RecorderConfig().to_mapping(), *(f"tactile.{name}" for name in RecorderConfig().tactile.to_mapping())}
    assert set(module.PARAMETERS.values()) <= known
    assert module.DESCRIPTIONS.keys() == module.PARAMETERS.keys()


def test_what_a_launch_file_needs_is_installed_beside_it() -> None:
    installed = {path.name for path in FOLDER.glob("*.*")}  # the pattern of setup.py
    assert "foretouch_launch_helpers.py" in installed
    assert not any(
        name.endswith("launch.py") for name in installed if ".launch." not in name
    )  # `ros2 launch` lists such
