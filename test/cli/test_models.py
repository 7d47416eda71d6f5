# SPDX-License-Identifier: Apache-2.0
"""`models`: skill, coverage and limits of each, and verification of every file."""

import hashlib
from typing import Any

from calibrated_models import save_calibrated_contact, save_calibrated_network
from every_case import every_case
from own_predictors import Constant

from foretouch.models import available_models
from foretouch.models.own import save_own
from foretouch.models.registry import find_card


def test_every_model_of_the_package_has_skill_files_and_intervals(call) -> None:
    answer = call("models", "--json")
    assert answer.status == 0
    assert [record["name"] for record in answer.records] == available_models()

    def check(record: dict[str, Any]) -> None:
        assert set(record["skill"]) == {"random", "time", "object"}
        for name, one in record["files"].items():
            content = find_card(record["name"]).with_name(name).read_bytes()
            assert (one["sha256"], one["bytes"]) == (hashlib.sha256(content).hexdigest(), len(content))
        assert record["bytes"] == sum(one["bytes"] for one in record["files"].values()) < 10_000_000
        assert record["calibration"] is not None
        assert any(name.endswith(".trust.safetensors") for name in record["files"])

    every_case({record["name"]: record for record in answer.records}, check)
    table, one = call("models").out, call("models", available_models()[0]).out
    assert "One pair of fingers" not in table  # the limits of a model stand behind its name
    assert "foretouch models NAME" in table
    assert "\n- One pair of fingers" in one
    assert "the card holds no skills" not in one


def test_a_model_of_own_code_is_not_damaged_and_says_what_it_needs(call, tmp_path) -> None:
    card = save_own(tmp_path / "mine.json", Constant(), {})
    answer = call("models", card, "--json")
    assert (answer.status, answer.records[0]["status"]) == (1, "needs --predictor")
    assert "--predictor own_predictors:Constant" in answer.records[0]["reason"]
    shown = call("models", card, "--predictor", "own_predictors:Constant")
    assert shown.status == 0
    assert "the card holds no skills: `foretouch train` with release=true" in " ".join(shown.out.split())


def test_coverage_is_that_of_the_card_and_a_flipped_byte_or_an_absent_file_is_found(call, tmp_path) -> None:
    (record,) = call("models", save_calibrated_contact(tmp_path), "--json").records
    result = record["calibration"]
    assert (record["kind"], result["level"], result["objects"], result["promise"]) == ("contact", 0.9, 4, 0.8)
    assert result["regimes"]["new"] == {"objects": 4, "samples": 40, "coverage": 0.91}
    table = call("models", tmp_path / "contact.json").out
    assert "0.91" in table
    assert "the guaranteed coverage of one more is at most 80%" in table
    card = save_calibrated_network(tmp_path)

    def check(name: str) -> None:
        path = tmp_path / name
        good = path.read_bytes()
        path.write_bytes(good[:-3] + bytes([good[-3] ^ 1]) + good[-2:])
        answer = call("models", card, "--json")
        assert (answer.status, answer.records[0]["status"]) == (1, "damaged")
        assert f"{name}: sha256" in answer.records[0]["reason"]
        assert f"{name}: sha256" in call("models", card).out
        path.unlink()
        assert f"{name}: no such weights" in call("models", card, "--json").records[0]["reason"]
        path.write_bytes(good)

    every_case(["calibrated.safetensors", "calibrated.trust.safetensors"], check)
