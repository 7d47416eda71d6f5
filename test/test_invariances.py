# SPDX-License-Identifier: Apache-2.0
"""What the committed table of invariances calls exact is exact on made clouds (benchmarks/invariances)."""

from __future__ import annotations

import csv
import importlib.util
import sys
from collections import defaultdict
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from foretouch.models import load_model
from foretouch.simulation.depth_scene import random_scene

pytestmark = pytest.mark.committed_numbers

FOLDER = Path(__file__).parents[1] / "benchmarks" / "invariances"
FAST = ("order of points", "shift 1 mm", "mirror", "one far outlier", "jitter 1 µm")


@pytest.fixture(scope="module")
def bench() -> ModuleType:
    sys.path.insert(0, str(FOLDER))
    spec = importlib.util.spec_from_file_location("invariances_bench", FOLDER / "bench.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    sys.path.remove(str(FOLDER))
    return module


@pytest.fixture(scope="module")
def exact() -> set[tuple[str, str]]:
    with (FOLDER / "results.csv").open(encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if row["refused"] == "0"]
    return {(row["step"], row["change"]) for row in rows if float(row["largest"]) == 0.0}


def _check(found: dict[tuple[str, str], list[float]], exact: set[tuple[str, str]]) -> None:
    checked = {key: values for key, values in found.items() if key in exact}
    assert checked
    assert {key: values for key, values in checked.items() if max(values) > 0.0} == {}


def test_objects(bench: ModuleType, exact: set[tuple[str, str]]) -> None:
    xyz = next(bench.made_objects())
    models = {name: load_model(name) for name in bench.MODELS}
    spread = np.ones(len(bench.ContactScene(xyz).describe([bench.given_grasp(xyz)[0]])[0]))
    found = defaultdict(list)
    for change in bench.changes():
        if change.name in FAST:
            bench.object_steps(found, xyz, change, models, spread, np.random.default_rng(0))
    bench.batch(found, xyz, models)
    assert {("GeoGrasp stable: best grasp", "order of points"), ("contact features", "1 grasp or 100")} <= exact
    _check(found, exact)


def test_scenes(bench: ModuleType, exact: set[tuple[str, str]]) -> None:
    image = random_scene(np.random.default_rng(0), 424, 240).render(np.random.default_rng(0), 0.001).cloud().xyz
    found = defaultdict(list)
    for change in bench.changes():
        if change.name in FAST and change.name not in bench.LIST_ONLY:
            bench.scene_steps(found, image, change, np.random.default_rng(0))
    _check(found, exact)


@pytest.mark.ros
def test_the_messages_of_the_live_graph_change_no_bit(bench: ModuleType, exact: set[tuple[str, str]]) -> None:
    pytest.importorskip("rclpy", reason="ROS 2 is not installed")
    found = defaultdict(list)
    bench.live(found)
    assert {key for key in found if key not in exact} == set()
    _check(found, exact)
