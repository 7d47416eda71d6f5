# SPDX-License-Identifier: Apache-2.0
"""What holds for the package as a whole: one version, a core without ROS, a prompt command line."""

from __future__ import annotations

import os
import pkgutil
import subprocess
import sys
import time
import xml.etree.ElementTree as ET
from importlib import metadata
from pathlib import Path

import pytest

import foretouch

ROOT = Path(__file__).parents[1]
PACKAGES = [
    "cloud",
    "grasp",
    "tactile",
    "models",
    "learning",
    "dataset",
    "simulation",
    "report",
    "pipeline",
    "types",
    "config",
]


@pytest.mark.parametrize("folder", [".", "foretouch_msgs"])
def test_package_xml_has_our_version(folder: str) -> None:
    version = ET.parse(ROOT / folder / "package.xml").getroot().findtext("version")
    assert version == foretouch.__version__


def test_the_installed_messages_have_our_version() -> None:
    pytest.importorskip("foretouch_msgs", reason="foretouch_msgs is not installed")
    assert metadata.version("foretouch_msgs") == foretouch.__version__


def test_every_core_module_imports_without_ros() -> None:
    names = [f"foretouch.{package}" for package in PACKAGES]
    for package in PACKAGES:
        folder = ROOT / "src" / "foretouch" / package
        if folder.is_dir():
            names += [f"foretouch.{package}.{module.name}" for module in pkgutil.iter_modules([str(folder)])]
    code = (
        f"import importlib, sys\nfor name in {names!r}: importlib.import_module(name)\n"
        "print([name for name in sys.modules if name == 'rclpy' or name.endswith('_msgs')])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "[]"


def test_help_does_not_wait_for_heavy_libraries() -> None:
    code = (
        "import sys\nfrom foretouch.cli.main import main\n"
        "try: main(['predict', '--help'])\nexcept SystemExit: pass\n"
        "print([n for n in ('torch', 'open3d', 'scipy', 'rclpy', 'matplotlib', 'rosbags') if n in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    assert done.stdout.strip().endswith("[]")


def test_help_answers_at_once() -> None:
    best = min(_cpu_seconds_of_help() for _ in range(3))
    assert best < 0.3


def _cpu_seconds_of_help() -> float:
    before = os.times()
    began = time.perf_counter()
    subprocess.run([sys.executable, "-m", "foretouch.cli.main", "--help"], capture_output=True, check=True, timeout=60)
    after = os.times()
    used = after.children_user - before.children_user + after.children_system - before.children_system
    return min(used, time.perf_counter() - began)
