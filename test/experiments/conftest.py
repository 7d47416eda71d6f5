# SPDX-License-Identifier: Apache-2.0
"""Data for experiments of one's own."""

from pathlib import Path

import pytest


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
