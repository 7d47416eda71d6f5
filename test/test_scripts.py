# SPDX-License-Identifier: Apache-2.0
"""Benchmarks and examples are run by hand: what they import of the package must not have moved meanwhile."""

import ast
import importlib
import importlib.util
from pathlib import Path

from every_case import every_case

ROOT = Path(__file__).parents[1]
OPTIONAL = {"pyrealsense2", "rclpy", "sensor_msgs", "foretouch_msgs", "std_msgs", "geometry_msgs"}  # extras
SCRIPTS = sorted([*ROOT.glob("benchmarks/**/*.py"), *ROOT.glob("examples/*.py"), ROOT / "docs" / "drawings.py"])


def check(script: Path) -> None:
    for node in ast.walk(ast.parse(script.read_text())):
        names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
        for name in [*names, node.module or ""] if isinstance(node, ast.ImportFrom) else names:
            root = name.partition(".")[0]
            assert root in OPTIONAL or (script.parent / f"{root}.py").exists() or importlib.util.find_spec(root), name
        if not isinstance(node, ast.ImportFrom) or not (node.module or "").startswith(("foretouch.", "benchmarks.")):
            continue
        module = importlib.import_module(node.module)
        for name in (alias.name for alias in node.names):
            if not hasattr(module, name):
                importlib.import_module(f"{node.module}.{name}")


def test_what_scripts_import_is_there() -> None:
    assert len(SCRIPTS) > 20
    every_case({str(path.relative_to(ROOT)): path for path in SCRIPTS}, check)
