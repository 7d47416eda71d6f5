# SPDX-License-Identifier: Apache-2.0
"""`foretouch doctor --self-test`: what it reports of a good machine, and of a broken one."""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from every_case import every_case

import foretouch
from foretouch.cli import selftest
from foretouch.cli.main import main
from foretouch.models import available_models, load_model
from foretouch.types import Cloud

PACKAGE = Path(foretouch.__file__).parent


@pytest.mark.committed_numbers
def test_models_are_as_expected_here() -> None:
    count = len(available_models())
    assert selftest.ROWS["models"]() == selftest.RowResult("models", "ok", f"{count} of {count} as expected")


def test_one_bit_in_each_coordinate_moves_answers_far_less_than_the_tolerance(rng) -> None:
    def check(name: str) -> None:
        model, xyz = load_model(name), selftest.exact_cloud().xyz
        moved = np.nextafter(xyz, np.where(rng.random(xyz.shape) < 0.5, np.float32(-9), np.float32(9)))
        one, other = (model.predict(Cloud(points), selftest.exact_grasps()) for points in (xyz, moved))
        for a, b in zip(one, other, strict=True):
            assert np.abs(a.value.values - b.value.values).max() <= selftest._TOLERANCE_COUNTS / 10

    every_case(sorted(available_models()), check)


def test_what_is_not_as_expected_is_named(monkeypatch, tmp_path) -> None:
    counts = json.loads(selftest._EXPECTED.read_text())["contact-v2"]["counts"]
    expected = {"contact-v2": {"sha256": "0" * 64, "counts": counts}, "gone": {}}
    (tmp_path / "expected.json").write_text(json.dumps(expected))
    monkeypatch.setattr(selftest, "_EXPECTED", tmp_path / "expected.json")
    row = selftest.ROWS["models"]()
    assert (row.state, row.found[0], row.fix) == ("failed", "0", "pip install --force-reinstall foretouch")
    for name, reason in (
        ("contact-v2", f"contact-v2: sha256: .* is not {'0' * 64} of this version"),
        ("touchnet-v1", "touchnet-v1: has no stored values to compare with"),
        ("gone", "gone"),
    ):
        assert re.search(reason, selftest._fault(name, expected.get(name)))
    counts[0][0] += 2 * selftest._TOLERANCE_COUNTS
    stored = {"sha256": load_model("contact-v2").sha256, "counts": counts}
    assert selftest._fault("contact-v2", stored) == "model contact-v2: answers differ by 1 counts"


def test_a_process_that_crashes_or_hangs_is_a_failed_row(monkeypatch, tmp_path) -> None:
    interpreter = tmp_path / "python"
    monkeypatch.setattr(selftest, "_PATIENCE_S", 0.5)
    monkeypatch.setattr(sys, "executable", str(interpreter))

    def check(script: str, cause: str) -> None:
        interpreter.write_text(f"#!/bin/sh\n{script}\n")
        interpreter.chmod(0o755)
        (row,) = selftest.run_rows(["models"])
        assert (row.row, row.state, row.cause) == ("models", "failed", cause)

    cases = [
        ("kill -ABRT $$", "its process ended by SIGABRT"),
        ("echo words; echo 'first\nlast' >&2; exit 1", "its process ended by exit status 1: last"),
        ("exec sleep 60", "takes more than 0.5 s"),
    ]
    every_case(cases, check)


def test_ros_is_skipped_by_name_where_it_is_not_installed(monkeypatch) -> None:
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    monkeypatch.setitem(sys.modules, "foretouch_msgs", None)
    row = selftest.ROWS["ROS"]()
    assert (row.state, row.found[:14]) == ("skipped", "not installed:")


def test_rows_are_shown_as_a_table(capsys) -> None:
    assert main(["doctor", "--self-test", "models"]) == 0
    out = capsys.readouterr().out
    assert "as expected" in out
    assert out.splitlines()[-1].startswith("1 rows, 0 failed")
    assert main(["doctor", "--self-test", "engine"]) == 1
    assert "--self-test: 'engine' is not one of models, ROS" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.ros
def test_a_damaged_model_in_an_installation(tmp_path) -> None:
    pytest.importorskip("rclpy")
    pytest.importorskip("foretouch_msgs.msg")
    shutil.copytree(PACKAGE, tmp_path / "foretouch", ignore=shutil.ignore_patterns("__pycache__"))
    weights = tmp_path / "foretouch/models/weights/touchnet-v1.safetensors"
    content = bytearray(weights.read_bytes())
    content[-5] ^= 1
    weights.write_bytes(content)
    words = [sys.executable, "-m", "foretouch.cli.main", "doctor", "--json", "--self-test", "models", "ROS"]
    environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
    done = subprocess.run(words, env=environment, capture_output=True, text=True, check=False)
    models, ros = (json.loads(line) for line in done.stdout.splitlines())
    assert (done.returncode, done.stderr, models["state"]) == (1, "", "failed")
    assert "touchnet-v1" in models["cause"]
    assert "sha256" in models["cause"]
    assert (ros["state"], ros["found"]) == ("ok", "cloud over DDS, hostile request refused")
