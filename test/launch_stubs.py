# SPDX-License-Identifier: Apache-2.0
"""The parts of `launch` and `launch_ros` that our launch files use, for machines without them: they are not on PyPI.

The stubs keep what they are given and perform substitutions, so that a test can read the nodes that a file describes.
"""

import sys
from types import ModuleType, SimpleNamespace
from typing import NamedTuple

import pytest


class LaunchContext:
    def __init__(self) -> None:
        self.launch_configurations: dict[str, str] = {}


class LaunchConfiguration(NamedTuple):
    name: str

    def perform(self, context: LaunchContext) -> str:
        return context.launch_configurations[self.name]


class IfCondition(NamedTuple):
    value: LaunchConfiguration

    def evaluate(self, context: LaunchContext) -> bool:
        return {"true": True, "false": False}[self.value.perform(context)]


class DeclareLaunchArgument(NamedTuple):
    name: str
    default_value: str | None = None
    description: str = ""


class PackageNotFoundError(KeyError):
    pass


def get_package_prefix(name: str) -> str:
    raise PackageNotFoundError(name)


_MODULES = {
    "ament_index_python": {},
    "ament_index_python.packages": {
        "PackageNotFoundError": PackageNotFoundError,
        "get_package_prefix": get_package_prefix,
    },
    "launch": {
        "LaunchContext": LaunchContext,
        "LaunchDescription": lambda entities: SimpleNamespace(entities=entities),
    },
    "launch.actions": {
        "DeclareLaunchArgument": DeclareLaunchArgument,
        "IncludeLaunchDescription": lambda source, **options: SimpleNamespace(source=source, **options),
        "OpaqueFunction": SimpleNamespace,
        "Shutdown": SimpleNamespace,
    },
    "launch.conditions": {"IfCondition": IfCondition},
    "launch.launch_description_sources": {"PythonLaunchDescriptionSource": lambda path: path},
    "launch.substitutions": {
        "LaunchConfiguration": LaunchConfiguration,
        "PathJoinSubstitution": lambda parts: SimpleNamespace(parts=parts),
    },
    "launch_ros": {},
    "launch_ros.actions": {
        "Node": lambda **options: SimpleNamespace(options=options, node_executable=options["executable"])
    },
    "launch_ros.substitutions": {"FindPackageShare": lambda package: package},
}


def install(monkeypatch: pytest.MonkeyPatch) -> None:
    """Offer the stubs under the names of the modules."""
    for name, contents in _MODULES.items():
        module = ModuleType(name)
        module.__dict__.update(contents, __path__=[])
        monkeypatch.setitem(sys.modules, name, module)
