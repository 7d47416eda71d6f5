# SPDX-License-Identifier: Apache-2.0
"""`models`: skill, coverage and limits of each, run folders, and verification of every file."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from calibrated_models import save_calibrated_contact, save_calibrated_network

from foretouch.cli.models import model_files
from foretouch.models import available_models
from foretouch.models.network.checkpoint import save_ensemble
from foretouch.models.registry import find_card

Call = Callable[..., Any]


def test_every_model_of_the_package_has_skill_files_and_intervals(call: Call) -> None:
    answer = call("models", "--json")
    assert answer.status == 0
    assert [record["name"] for record in answer.records] == available_models()
    for record in answer.records:
        assert set(record["skill"]) == {"random", "time", "object"}
        for name, one in record["files"].items():
            content = find_card(record["name"]).with_name(name).read_bytes()
            assert (one["sha256"], one["bytes"]) == (hashlib.sha256(content).hexdigest(), len(content))
        assert record["bytes"] == sum(one["bytes"] for one in record["files"].values()) < 10_000_000
        calibrated = record["card"].get("calibration") is not None
        assert (record["calibration"] is not None) == calibrated
        assert any(name.endswith(".trust.safetensors") for name in record["files"]) == calibrated


def test_coverage_and_guarantee_are_those_of_the_card(call: Call, tmp_path: Path) -> None:
    (record,) = call("models", save_calibrated_contact(tmp_path), "--json").records
    result = record["calibration"]
    assert (record["kind"], result["level"], result["objects"], result["promise"]) == ("contact", 0.9, 4, 0.8)
    assert result["regimes"]["new"] == {"objects": 4, "samples": 40, "coverage": 0.91}
    table = call("models", tmp_path / "contact.json").out
    assert "0.91" in table
    assert "the guaranteed coverage of one more object is at most 80%" in table


@pytest.mark.parametrize("name", ["calibrated.safetensors", "calibrated.trust.safetensors"])
def test_a_flipped_byte_in_any_file_is_found(call: Call, tmp_path: Path, name: str) -> None:
    card = save_calibrated_network(tmp_path)
    data = bytearray((tmp_path / name).read_bytes())
    data[-3] ^= 1
    (tmp_path / name).write_bytes(data)
    answer = call("models", card, "--json")
    assert answer.status == 1
    assert answer.records[0]["status"] == "damaged"
    assert f"{name}: sha256" in answer.records[0]["reason"]
    assert f"{name}: sha256" in call("models", card).out


def test_an_absent_calibration_is_named(call: Call, tmp_path: Path) -> None:
    card = save_calibrated_network(tmp_path)
    (tmp_path / "calibrated.trust.safetensors").unlink()
    (record,) = call("models", card, "--json").records
    assert "calibrated.trust.safetensors: no such weights" in record["reason"]


def test_files_of_an_ensemble_are_those_of_its_members(tmp_path: Path) -> None:
    card = save_calibrated_network(tmp_path)
    both = save_ensemble(tmp_path, "both", [card])
    names = ["calibrated.json", "calibrated.safetensors", "calibrated.trust.safetensors"]
    assert [path.name for path in model_files(both)] == names
