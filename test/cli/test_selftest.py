# SPDX-License-Identifier: Apache-2.0
"""`foretouch doctor --self-test`: what it reports of a good machine, and of a broken one."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from every_case import every_case

import foretouch
from foretouch.cli import selftest
from foretouch.errors import ModelError
from foretouch.models import available_models, load_model
from foretouch.types import Cloud

PACKAGE = Path(foretouch.__file__).parent


@pytest.mark.committed_numbers
def test_models_are_as_expected_here() -> None:
    selftest.check_models()


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
    with pytest.raises(ModelError, match=f"model contact-v2: sha256: .* is not {'0' * 64} of this version"):
        selftest.check_models()
    assert selftest._fault("touchnet-v1", None) == "model touchnet-v1: has no stored values to compare with"
    assert "gone" in selftest._fault("gone", {})
    counts[0][0] += 2 * selftest._TOLERANCE_COUNTS
    stored = {"sha256": load_model("contact-v2").sha256, "counts": counts}
    assert selftest._fault("contact-v2", stored) == "model contact-v2: answers differ by 1 counts"


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
    words = [sys.executable, "-m", "foretouch.cli.main", "doctor", "--json", "--self-test"]
    environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
    done = subprocess.run(words, env=environment, capture_output=True, text=True, check=False)
    found = {one["name"]: one for one in map(json.loads, done.stdout.splitlines())}
    models, ros = found["models answer as expected"], found["a node answers over DDS"]
    assert (done.returncode, models["state"], ros["state"]) == (1, "broken", "ok")
    assert "touchnet-v1" in models["found"]
    assert "sha256" in models["found"]
