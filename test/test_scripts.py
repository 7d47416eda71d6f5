# SPDX-License-Identifier: Apache-2.0
"""Benchmarks and examples are run by hand: what they import of the package must not have moved meanwhile."""

import ast
import importlib
import importlib.util
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
from every_case import every_case

from foretouch.cloud import read_cloud
from foretouch.dataset.source import open_source
from foretouch_lab.simulation.scene import load_scene

ROOT = Path(__file__).parents[1]
OPTIONAL = {
    "pyrealsense2",
    "rclpy",
    "sensor_msgs",
    "foretouch_msgs",
    "std_msgs",
    "geometry_msgs",
    "moveit_msgs",
}  # extras
SCRIPTS = sorted([*ROOT.glob("benchmarks/**/*.py"), *ROOT.glob("examples/*.py"), *ROOT.glob("docs/*.py")])


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


def test_the_example_makes_a_recording_that_opens(tmp_path) -> None:
    command = [sys.executable, str(ROOT / "examples" / "make_recording.py"), str(tmp_path / "made"), "count=2"]
    subprocess.run(command, check=True, timeout=60)
    assert len(list(open_source(tmp_path / "made"))) == 2


def test_the_drawn_touches_are_within_their_intervals_and_compare_one_grasp(monkeypatch) -> None:
    monkeypatch.syspath_prepend(str(ROOT / "examples"))
    drawn = importlib.import_module("draw_touch").grasps_to_draw(load_scene(ROOT / "config" / "scenes" / "demo.yaml"))
    assert len(drawn) == 2
    for grasp in drawn:
        assert np.array_equal(grasp.earlier.grasp.g1, grasp.prediction.grasp.g1)
        assert grasp.earlier.evidence.touches < grasp.prediction.evidence.touches == 2
        for prediction in (grasp.earlier, grasp.prediction):
            read = grasp.read.values
            inside = (prediction.lower.values <= read) & (read <= prediction.upper.values)
            assert inside.mean() > 0.8, grasp.title  # of intervals of 90 %


def checked(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """What `docker/check.sh` does in a folder, without a ROS 2 installation."""
    environment = {name: value for name, value in os.environ.items() if name != "ROS_DISTRO"}
    command = ["bash", ROOT / "docker" / "check.sh", *arguments]
    return subprocess.run(command, check=False, cwd=folder, env=environment, capture_output=True, text=True, timeout=60)


def test_the_check_of_a_full_ros_2_goes_on_after_a_failed_step_and_reports_it(tmp_path) -> None:
    steps = checked(tmp_path, "--list").stdout.split()
    done = checked(tmp_path, "machine", "doctor")
    report = (tmp_path / "foretouch-report.txt").read_text()
    assert (done.returncode, "2 steps, 2 failed" in done.stdout) == (1, True)
    assert re.findall(r"^== (\w+): FAILED", report, re.MULTILINE) == ["machine", "doctor"]
    assert "ROS_DISTRO is not set" in report
    assert checked(tmp_path, "nope").returncode == 2
    recipe = (ROOT / "docker" / "jazzy.Dockerfile").read_text()
    called = re.findall(r"check.sh (?:--report \S+ )?(.*)|\"(\w+)\"(?=[,\]])", recipe.partition("FROM")[2])
    assert {word for pair in called for text in pair for word in text.split()} - {"bash"} == set(steps)
    (pip,) = re.findall(
        r"^pip install -c .*?constraints.txt (.*)$", (ROOT / "docs" / "install.md").read_text(), re.MULTILINE
    )
    assert f'pip install -q -c "$HERE/constraints.txt" {pip} ' in (ROOT / "docker" / "check.sh").read_text()


def test_the_clouds_beside_the_examples_are_those_of_their_scene(tmp_path) -> None:
    data = ROOT / "examples" / "data"
    run_script = [sys.executable, ROOT / "examples" / "make_clouds.py", data / "table.yaml", tmp_path]
    subprocess.run(run_script, check=True, capture_output=True, timeout=120)
    for name in ("table.npz", "can.ply"):
        committed, made = read_cloud(data / name), read_cloud(tmp_path / name)
        np.testing.assert_allclose(committed.xyz, made.xyz, atol=1e-5)  # clouds are float32, the camera's step is 1 mm
        assert committed.frame_id == made.frame_id
    assert sum(path.stat().st_size for path in data.iterdir()) < 2e6
    for path in data.glob("*.yaml"):
        load_scene(path)
