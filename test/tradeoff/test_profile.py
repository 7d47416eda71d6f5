# SPDX-License-Identifier: Apache-2.0
"""The profile of a machine: kept, measured again for another machine or version, and bad files."""

import json
from pathlib import Path

import numpy as np
import pytest

from foretouch.cli.main import main
from foretouch.models import load_model
from foretouch.tradeoff.budget import profile as profiles
from foretouch.tradeoff.budget.levels import levels_of
from foretouch.tradeoff.budget.profile import load_profile, profile_path, profile_scene


@pytest.fixture
def levels():
    return levels_of(load_model())


@pytest.fixture(autouse=True)
def measured(monkeypatch, tmp_path):
    """Counts measurements, and answers them at once: a level takes 2 ms for each of those after it."""
    calls = []

    def measure(levels, seconds, progress):
        calls.append(seconds)
        times = {one.name: {1: 0.002 * (len(levels) - k), 100: 0.05} for k, one in enumerate(levels)}
        return times, "idle"

    monkeypatch.setattr(profiles, "_measure", measure)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return calls


def test_it_is_measured_once_and_kept(levels, measured) -> None:
    said: list[str] = []
    first = load_profile(levels, say=said.append)
    second = load_profile(levels, say=said.append)
    assert len(measured) == 1
    assert first == second
    assert len(said) == 1
    assert "there is no profile yet: measuring" in said[0]
    assert second.origin == str(profile_path(levels))


@pytest.mark.parametrize(
    ("field", "value"),
    [("cpu", "another"), ("cores", 96), ("foretouch", "0.0"), ("numpy", "1.0"), ("model", "00"), ("levels", ["x"])],
)  # fmt: skip
def test_another_machine_version_or_model_is_measured_again_with_a_word(levels, measured, field, value) -> None:
    load_profile(levels)
    path = profile_path(levels)
    document = json.loads(path.read_text())
    document["fingerprint"][field] = value
    path.write_text(json.dumps(document))
    said: list[str] = []
    load_profile(levels, say=said.append)
    assert len(measured) == 2
    assert f"{field}: is of {value!r}, not of" in said[0]
    load_profile(levels, say=said.append)
    assert len(said) == 1


@pytest.mark.parametrize("content", ["", "{}", "[1]", '{"format": "foretouch-profile", "format_version": 2}'])
def test_a_damaged_file_is_measured_again(levels, measured, content) -> None:
    load_profile(levels)
    profile_path(levels).write_text(content)
    said: list[str] = []
    load_profile(levels, say=said.append)
    assert (len(measured), len(said)) == (2, 1)


@pytest.mark.parametrize("times", [{}, {"1": 0.0}, {"1": None}, {"one": 1.0}, {"1": float("inf")}])
def test_times_that_are_none_are_measured_again(levels, measured, times) -> None:
    load_profile(levels)
    path = profile_path(levels)
    document = json.loads(path.read_text())
    document["p95_s"][levels[0].name] = times
    path.write_text(json.dumps(document))
    load_profile(levels)
    assert len(measured) == 2


def test_a_folder_that_cannot_be_written_keeps_it_in_memory(levels, tmp_path: Path, monkeypatch) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    said: list[str] = []
    profile = load_profile(levels, say=said.append)
    assert profile.seconds(levels[0].name, 1) > 0.0
    assert "kept in memory" in said[-1]
    assert str(tmp_path / "file") in said[-1]


def test_times_of_other_numbers_of_grasps(levels) -> None:
    profile = load_profile(levels)
    name = levels[-1].name
    assert profile.seconds(name, 1) == 0.002
    assert profile.seconds(name, 100) == 0.05
    assert profile.seconds(name, 199) == pytest.approx(0.05 + 99 * 0.048 / 99)


def test_the_command_and_a_prediction_with_a_budget(capsys, monkeypatch, tmp_path) -> None:
    assert main(["tradeoff", "profile", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["status"] == "done"
    assert next(iter(document["levels"])) == "contact-v2"
    assert main(["tradeoff", "profile"]) == 0
    assert "mean of" in capsys.readouterr().out


def test_predict_within_a_budget(capsys, tmp_path) -> None:
    cloud, grasps = profile_scene(1)
    path = tmp_path / "can.npz"
    np.savez(path, xyz=cloud.xyz)
    contacts = ",".join(f"{value:.6f}" for value in (*grasps[0].g1, *grasps[0].g2))
    words = ["predict", str(path), f"--grasp={contacts}", "--plane=0,0,1,-1.27", "--json"]
    for budget, level in ((None, None), ("10000", "contact-v2"), ("3", "mean of labels"), ("0.5", "mean of labels")):
        more = [] if budget is None else ["--budget-ms", budget]
        assert main([*words, *more]) == 0
        out, err = capsys.readouterr()
        record = json.loads(out)
        assert record.get("level") == level
        assert ("reduced" in record["predictions"][0]["flags"]) == (level == "mean of labels")
        assert ("nothing meets it for 1 grasps: mean of labels is used" in err) == (budget == "0.5")
    with pytest.raises(SystemExit):
        main([*words, "--budget-ms", "0"])
    assert "0 is not above 0" in capsys.readouterr().err
