# SPDX-License-Identifier: Apache-2.0
"""`foretouch doctor --self-test`, with what is broken in a copy of the package."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import foretouch
from foretouch.cli import self_test

Call = Callable[..., Any]
PACKAGE = Path(foretouch.__file__).parent


def doctor(source: Path, *rows: str) -> tuple[int, list[dict[str, Any]]]:
    """Exit status and rows of the real command, with the package at `source`."""
    words = [sys.executable, "-m", "foretouch.cli.main", "doctor", "--json", "--self-test", *rows]
    done = subprocess.run(
        words, env={**os.environ, "PYTHONPATH": str(source)}, capture_output=True, text=True, check=False
    )
    assert done.stderr == ""
    return done.returncode, [json.loads(line) for line in done.stdout.splitlines()]


@pytest.fixture
def copied(tmp_path: Path) -> Path:
    """A copy of the package that may be broken."""
    shutil.copytree(PACKAGE, tmp_path / "foretouch", ignore=shutil.ignore_patterns("__pycache__"))
    return tmp_path


def test_models_and_references_are_as_expected_here() -> None:
    status, rows = doctor(PACKAGE.parent, "models", "references")
    assert (status, [(one["row"], one["state"]) for one in rows]) == (0, [("models", "ok"), ("references", "ok")])
    assert rows[0]["found"] == "3 of 3 as expected"


def test_a_damaged_model_is_reported_with_its_fix(copied: Path) -> None:
    weights = copied / "foretouch/models/weights/contact-v1.safetensors"
    content = bytearray(weights.read_bytes())
    content[-5] ^= 1
    weights.write_bytes(content)
    status, (row,) = doctor(copied, "models")
    assert (status, row["state"], row["found"]) == (1, "failed", "2 of 3 as expected")
    assert "model: contact-v1: is refused: " in row["cause"]
    assert "sha256" in row["cause"]
    assert row["fix"] == "pip install --force-reinstall foretouch"


def test_a_model_that_was_replaced_with_its_card_is_reported(copied: Path) -> None:
    expected = copied / "foretouch/selftest/expected.json"
    document = json.loads(expected.read_text())
    document["contact-v1"]["sha256"] = "0" * 64
    expected.write_text(json.dumps(document))
    status, (row,) = doctor(copied, "models")
    assert status == 1
    assert f"is not {'0' * 64} of this version" in row["cause"]


def test_a_broken_kernel_is_reported(copied: Path) -> None:
    module = copied / "foretouch/tactile/readings.py"
    module.write_text(module.read_text().replace("- 1.0) * _REFERENCE_KOHM", "- 1.000001) * _REFERENCE_KOHM"))
    status, (row,) = doctor(copied, "references")
    assert (status, row["found"]) == (1, "8 of 9 as expected")
    assert row["cause"].startswith("reference: impedance [relative]: the answer is wrong: ")


def test_a_crash_names_its_row_and_the_next_rows_run(copied: Path) -> None:
    module = copied / "foretouch/selftest/references.py"
    module.write_text(module.read_text() + "\n\nimport os\n\n\ndef invariance_cases():\n    os.abort()\n")
    status, rows = doctor(copied, "invariances", "references")
    assert (status, [one["row"] for one in rows]) == (1, ["invariances", "references"])
    assert rows[0]["cause"] == "its process ended by SIGABRT"
    assert rows[1]["state"] == "ok"


def test_a_package_that_cannot_be_imported_names_the_import(copied: Path) -> None:
    (copied / "foretouch/selftest/case.py").write_text("import no_such_module\n")
    (copied / "foretouch/selftest/rows.py").write_text(
        (PACKAGE / "selftest/rows.py")
        .read_text()
        .replace("from foretouch.selftest.case import HardCase, fault", "HardCase = fault = None")
    )
    status, (row,) = doctor(copied, "models")
    assert status == 1
    assert row["cause"].endswith("ModuleNotFoundError: No module named 'no_such_module'")


def test_a_row_that_hangs_is_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(self_test, "_PATIENCE_S", 0.2)
    (row,) = self_test.run_rows(["training"])
    assert (row.state, row.cause) == ("failed", "takes more than 0.2 s")


def test_rows_are_shown_as_a_table(call: Call) -> None:
    answer = call("doctor", "--self-test", "timings")
    assert answer.status == 0
    assert "segment 848x480" in answer.out.replace("\n", " ")
    assert answer.out.splitlines()[-1].startswith("1 rows, 0 failed")


def test_an_unknown_row_is_refused(call: Call) -> None:
    answer = call("doctor", "--self-test", "engine")
    assert answer.status == 1
    assert "--self-test: 'engine' is none of models, references" in answer.err


@pytest.mark.ros
def test_ros() -> None:
    pytest.importorskip("rclpy")
    pytest.importorskip("foretouch_msgs.msg")
    status, (row,) = doctor(PACKAGE.parent, "ROS")
    assert (status, row["found"]) == (0, "cloud over DDS, hostile request refused")


def test_ros_is_skipped_by_name_where_it_is_not_installed(copied: Path) -> None:
    (copied / "foretouch_msgs").mkdir()
    (copied / "foretouch_msgs/__init__.py").write_text("raise ImportError('no messages')\n")
    status, (row,) = doctor(copied, "ROS")
    assert (status, row["state"], row["found"]) == (0, "skipped", "not installed: no messages")
