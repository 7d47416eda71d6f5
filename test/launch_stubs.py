# SPDX-License-Identifier: Apache-2.0
"""The parts of `launch` and `launch_ros` that our launch files use, for machines without them: they are not on PyPI.

The stubs keep what they are given and perform substitutions, so that a test can read the nodes that a file describes.
"""

import sys
from types import ModuleType, SimpleNamespace
from typing import NamedTuple

import pytest


class LaunchConfiguration(NamedTuple):
    name: str

    def perform(self, context: SimpleNamespace) -> str:
        return str(context.launch_configurations[self.name])


class IfCondition(NamedTuple):
    value: LaunchConfiguration

    def evaluate(self, context: SimpleNamespace) -> bool:
        return {"true": True, "false": False}[self.value.perform(context)]


_MODULES = {
    "ament_index_python": {},
    "ament_index_python.packages": {"PackageNotFoundError": KeyError, "get_package_prefix": {}.__getitem__},
    "launch": {
        "LaunchContext": lambda: SimpleNamespace(launch_configurations={}),
        "LaunchDescription": lambda entities: SimpleNamespace(entities=entities),
    },
    "launch.actions": {
        "DeclareLaunchArgument": lambda name, **options: SimpleNamespace(name=name, **options),
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
    "launch_ros.actions": {"Node": lambda **given: SimpleNamespace(options=given, node_executable=given["executable"])},
    "launch_ros.substitutions": {"FindPackageShare": lambda package: package},
}


def install(monkeypatch: pytest.MonkeyPatch) -> None:
    """Offer the stubs under the names of the modules."""
    for name, contents in _MODULES.items():
        module = ModuleType(name)
        module.__dict__.update(contents, __path__=[])
        monkeypatch.setitem(sys.modules, name, module)
