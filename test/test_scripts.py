# SPDX-License-Identifier: Apache-2.0
"""Benchmarks and examples are run by hand: what they import of the package must not have moved meanwhile."""

import ast
import importlib
import importlib.util
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
OPTIONAL = {"pyrealsense2", "rclpy", "sensor_msgs", "foretouch_msgs", "std_msgs", "geometry_msgs"}  # extras
SCRIPTS = sorted([*ROOT.glob("benchmarks/*/*.py"), *ROOT.glob("examples/*.py"), ROOT / "docs" / "drawings.py"])


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: f"{path.parent.name}/{path.name}")
def test_what_a_script_imports_is_there(script: Path) -> None:
    for node in ast.walk(ast.parse(script.read_text())):
        names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
        for name in (
            [*names, getattr(node, "module", None) or "sys"] if isinstance(node, ast.Import | ast.ImportFrom) else ()
        ):
            root = name.partition(".")[0]
            assert root in OPTIONAL or (script.parent / f"{root}.py").exists() or importlib.util.find_spec(root), name
        if not isinstance(node, ast.ImportFrom) or not (node.module or "").startswith("foretouch."):
            continue
        module = importlib.import_module(node.module)
        for name in (alias.name for alias in node.names):
            if not hasattr(module, name):
                importlib.import_module(f"{node.module}.{name}")


def test_there_are_scripts() -> None:
    assert len(SCRIPTS) > 20
