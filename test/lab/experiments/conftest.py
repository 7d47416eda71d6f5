# SPDX-License-Identifier: Apache-2.0
"""Data for experiments of one's own, and small sweeps of those on simulated grasps."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from foretouch_lab.experiments import find_experiment, run_sweep
from foretouch_lab.experiments.framework import sweep


@pytest.fixture
def numbers(tmp_path: Path) -> Path:
    path = tmp_path / "numbers.txt"
    path.write_text("1 2.5\n")
    return path


@pytest.fixture
def trace(tmp_path: Path) -> Path:
    path = tmp_path / "trace"
    path.mkdir()
    return path


@pytest.fixture(scope="session")
def scenes() -> Path:
    return Path(__file__).parents[3] / "config" / "scenes"


@pytest.fixture
def in_this_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Cells of sweeps run in the process of the test, which saves the start of others."""
    monkeypatch.setattr(
        sweep, "in_processes", lambda job, cells, workers: (sweep.run_cell(job, cell) for cell in cells)
    )


@pytest.fixture
def swept(
    tmp_path: Path, scenes: Path, monkeypatch: pytest.MonkeyPatch, in_this_process: None
) -> Callable[..., list[dict[str, Any]]]:
    """Runs the preset `smoke` with some changes, makes tables and figure, and returns the rows."""
    monkeypatch.chdir(scenes.parents[1])

    def run(name: str, source: Path, **changes: Any) -> list[dict[str, Any]]:
        experiment = find_experiment(name)
        result = run_sweep(experiment, experiment.resolve("smoke", changes), tmp_path / "out", source=source)
        assert result.failures == {}
        assert experiment.summarise(result.rows)
        assert all(figure.stat().st_size > 5000 for figure in experiment.draw(result.rows, tmp_path))
        return result.rows

    return run
