# SPDX-License-Identifier: Apache-2.0
"""Data for experiments of one's own, and small sweeps of those on simulated grasps."""

from pathlib import Path

import pytest

from foretouch_lab.experiments.framework import sweep
from foretouch_lab.ray_cluster import outcome


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
    monkeypatch.setattr(sweep, "in_processes", lambda run, cells, _: ((cell, *outcome(run, cell)) for cell in cells))
