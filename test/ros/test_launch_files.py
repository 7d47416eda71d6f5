# SPDX-License-Identifier: Apache-2.0
"""The launch files, where `launch` is installed: it comes with a full ROS 2 and is not on PyPI."""

import importlib.util
from pathlib import Path

import pytest

pytest.importorskip("launch", reason="launch comes with a full ROS 2 install only")
pytest.importorskip("launch_ros.actions", reason="launch_ros comes with a full ROS 2 install only")

FOLDER = Path(__file__).parents[2] / "launch"


def describe(name):
    spec = importlib.util.spec_from_file_location(name, FOLDER / f"{name}.launch.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module, module.generate_launch_description()


@pytest.mark.parametrize(
    ("name", "arguments"),
    [
        ("perception", {"namespace", "camera", "points", "model", "params_file", "one_process", "rviz"}),
        ("camera", {"namespace", "params_file"}),
        ("replay", {"path", "namespace", "model", "params_file", "rviz"}),
        ("recorder", {"record", "object", "folder", "tactile", "tactile_type", "namespace", "params_file"}),
    ],
)
def test_arguments_are_few_named_and_described(name, arguments):
    module, description = describe(name)
    assert {argument.name for argument in module.ARGUMENTS} == arguments
    assert all(argument.description for argument in module.ARGUMENTS)
    assert description.entities


@pytest.mark.parametrize(("together", "executables"), [("true", 1), ("false", 3)])
def test_perception_is_one_process_or_three(together, executables):
    from launch import LaunchContext

    module, _ = describe("perception")
    context = LaunchContext()
    context.launch_configurations.update(
        namespace="/left", points="/camera/points", model="m.json", params_file="", one_process=together
    )
    nodes = module.perception(context)
    assert len(nodes) == executables


def test_the_recorder_is_given_what_was_said_and_no_more():
    from launch import LaunchContext

    module, _ = describe("recorder")
    context = LaunchContext()
    context.launch_configurations.update(
        {**dict.fromkeys(module.PARAMETERS, ""), "object": "7", "namespace": "/left", "params_file": ""}
    )
    (node,) = module.recorder(context)
    assert node.node_executable == "foretouch_recorder"


def test_the_launch_file_of_the_recorder_names_parameters_that_it_has():
    from foretouch.ros.recorder.config import RecorderConfig

    module, _ = describe("recorder")
    known = {*RecorderConfig().to_mapping(), *(f"tactile.{name}" for name in RecorderConfig().tactile.to_mapping())}
    assert set(module.PARAMETERS.values()) <= known
