# SPDX-License-Identifier: Apache-2.0
"""The short form of `benchmarks/fuzz/files.py`: some changed files of each kind."""

import importlib.util
import sys
from pathlib import Path
from typing import Any

import pytest

SCRIPT = Path(__file__).parents[1] / "benchmarks" / "fuzz" / "files.py"
CASES = 30


def script() -> Any:
    """The script as a module."""
    spec = importlib.util.spec_from_file_location("fuzz_files", SCRIPT)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["fuzz_files"] = module
    spec.loader.exec_module(module)
    return module


FUZZ = script()


@pytest.mark.parametrize("kind", FUZZ.KINDS)
def test_no_changed_file_crashes_a_reader_or_is_used_in_silence(kind: str) -> None:
    row, faults = FUZZ.run(kind, CASES, 0)
    assert faults == []
    assert row["refused"] + row["read"] == CASES


def test_a_crash_by_a_signal_is_detected_and_named(tmp_path: Path) -> None:
    child = FUZZ.Child()
    good = FUZZ.KINDS["npy"].make(tmp_path)
    assert child.read("npy", good)["outcome"] == "read"
    child.process.send_signal(11)
    assert child.read("npy", good) == {"outcome": "signal", "detail": "exit status -11", "seconds": 0.0}
    assert child.read("npy", good)["outcome"] == "read"
    child.close()
