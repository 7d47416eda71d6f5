# SPDX-License-Identifier: Apache-2.0
"""The parts of `launch` and `launch_ros` that our launch files use, for machines without them: they are not on PyPI.

The stubs keep what they are given and perform substitutions, so that a test can read the nodes that a file describes.
"""

from __future__ import annotations

import sys
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest


class LaunchContext:
    def __init__(self) -> None:
        self.launch_configurations: dict[str, str] = {}


class LaunchConfiguration:
    def __init__(self, name: str) -> None:
        self.name = name

    def perform(self, context: LaunchContext) -> str:
        return context.launch_configurations[self.name]


class IfCondition:
    def __init__(self, value: LaunchConfiguration) -> None:
        self.value = value

    def evaluate(self, context: LaunchContext) -> bool:
        return {"true": True, "false": False}[self.value.perform(context)]


class DeclareLaunchArgument:
    def __init__(self, name: str, *, default_value: str | None = None, description: str = "") -> None:
        self.name, self.default_value, self.description = name, default_value, description


class PathJoinSubstitution:
    def __init__(self, parts: list[Any]) -> None:
        self.parts = parts


class FindPackageShare:
    def __init__(self, package: str) -> None:
        self.package = package


class Node:
    def __init__(self, **options: Any) -> None:
        self.options = options
        self.node_executable = options["executable"]


class PackageNotFoundError(KeyError):
    pass


def get_package_prefix(name: str) -> str:
    raise PackageNotFoundError(name)


def _options(**options: Any) -> SimpleNamespace:
    return SimpleNamespace(**options)


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
        "OpaqueFunction": _options,
        "Shutdown": _options,
    },
    "launch.conditions": {"IfCondition": IfCondition},
    "launch.launch_description_sources": {"PythonLaunchDescriptionSource": lambda path: path},
    "launch.substitutions": {"LaunchConfiguration": LaunchConfiguration, "PathJoinSubstitution": PathJoinSubstitution},
    "launch_ros": {},
    "launch_ros.actions": {"Node": Node},
    "launch_ros.substitutions": {"FindPackageShare": FindPackageShare},
}


def install(monkeypatch: pytest.MonkeyPatch) -> None:
    """Offer the stubs under the names of the modules."""
    for name, contents in _MODULES.items():
        module = ModuleType(name)
        module.__dict__.update(contents, __path__=[])
        monkeypatch.setitem(sys.modules, name, module)
