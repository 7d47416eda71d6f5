# SPDX-License-Identifier: Apache-2.0
"""What `make reference-times` publishes, and the picture of what there is within a time."""

import importlib.util
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from PIL import Image

from foretouch_lab.experiments.framework.manifest import write_results

ROOT = Path(__file__).parents[1]


@pytest.fixture
def times(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The script, which writes to a folder of the test."""
    spec = importlib.util.spec_from_file_location("reference_times", ROOT / "docs/reference_times.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    monkeypatch.setattr(module, "DOCS", tmp_path / "docs")
    return module


def chain(state: str = "idle") -> list[dict[str, Any]]:
    steps = ((4.0, 0.1), (8.0, 0.3), (9.0, 0.2), (40.0, 0.4))
    return [
        {"variant": str(ms), "state": state, "ms_p95": ms, "cpu_ms_p95": ms / 2.0, "chain": product}
        | {"found": 1.0, "held": 0.5, "touch": 2.0 * product}
        for ms, product in steps
    ]


def model() -> list[dict[str, Any]]:
    own = ((1, 2.0), (10, 4.0), (100, 10.0), (1000, 60.0))
    return [{"variant": "contact-v3", "request": n, "state": "idle", "ms_p95": ms, "cpu_ms": ms} for n, ms in own]


def test_what_there_is_within_a_time(times: ModuleType) -> None:
    rows = chain()
    assert [times.best_within(rows, ms) and times.best_within(rows, ms)["variant"] for ms in times.BUDGETS_MS] == [
        "4.0",
        "8.0",
        "8.0",
        "40.0",
    ]
    assert times.best_within(rows, 3.0) is None
    assert times.best_within(chain("loaded"), 3.0)["variant"] == "4.0"  # by the processor time
    assert [times.grasps_within(model(), ms) for ms in (1.0, 2.0, 4.0, 10.0, 60.0, 100.0)] == [
        0,
        1,
        10,
        100,
        1000,
        1000,
    ]
    assert 100 < times.grasps_within(model(), 30.0) < 1000


def test_tables_are_published_and_drawn(times: ModuleType, tmp_path: Path) -> None:
    for area, rows in (("chain", chain()), ("model", model())):
        folder = tmp_path / "measured" / area
        folder.mkdir(parents=True)
        write_results(folder, rows, "tradeoff.csv")
        for name in ("summary.md", "tradeoff.png", "manifest.json"):
            (folder / name).write_text(area)
    (tmp_path / "measured/scene").mkdir()  # not measured yet
    times.publish(tmp_path / "measured")
    published = tmp_path / "docs/results/tradeoff"
    assert sorted(str(path.relative_to(published)) for path in published.rglob("*.*")) == [
        f"{area}/{name}" for area in ("chain", "model") for name in ("summary.md", "tradeoff.csv", "tradeoff.png")
    ]
    with Image.open(times.draw(tmp_path / "docs")) as picture:
        assert picture.width > 700
