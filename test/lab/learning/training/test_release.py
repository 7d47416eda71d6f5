# SPDX-License-Identifier: Apache-2.0
"""`foretouch train release=true` and `--compare`, whole, on a small made-up folder of the public kind."""

import json
from pathlib import Path

import pytest
from recording_builders import read_folder
from run_builders import write_store

from foretouch.cli.main import main
from foretouch.dataset.formats import export_samples
from foretouch.dataset.formats.vision2tactile import folder_sha256
from foretouch.models import load_model

CONFIG = """
name: toy
model: {n_points: 32, tnet: false, trunk_widths: [8, 16], head_widths: [8], metric_inputs: true}
train: {epochs: 3, batch_size: 4}
"""


@pytest.fixture
def folder(tmp_path: Path, samples) -> Path:
    """Ten of the made-up samples, written as the recordings are."""
    chosen = [one for name in ("box0", "box1") for one in [s for s in samples if s.object == name][:5]]
    export_samples(write_store(tmp_path / "store", chosen), tmp_path / "data", "vision2tactile")
    return tmp_path / "data"


@pytest.fixture
def config(tmp_path: Path) -> Path:
    path = tmp_path / "toy.yaml"
    path.write_text(CONFIG)
    return path


def train(config: Path, folder: Path, *words: object) -> int:
    return main(["train", str(config), f"data={folder}", *map(str, words)])


@pytest.mark.slow
def test_it_evaluates_trains_and_writes_a_model_that_loads(folder: Path, config: Path, tmp_path, capsys) -> None:
    out = tmp_path / "out"
    assert train(config, folder, "train.epochs=2", "release=true", "-o", out, "--json") == 0
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [line["epoch"] for line in lines if "epoch" in line] == [0, 1]
    model = load_model(out)
    card = model.card
    assert card["data"]["sha256"] == folder_sha256(folder)
    assert card["data"]["objects"] == {"box0": 5, "box1": 5}
    assert card["training"]["train"]["epochs"] == 2
    for split in ("random", "time", "object"):
        reported = next(line for line in lines if line.get("split") == split and line.get("who") == "model")
        assert card["skill"][split]["E_MF"]["skill"] == pytest.approx(reported["skill"]["E_MF"], abs=1e-3)
        assert card["baselines"]["training_mean"][split]["PDC_TH"]["skill"] == pytest.approx(0.0, abs=1e-9)
        assert any(line.startswith(f"Split {split}: mean skill") for line in card["limits"])
    sample = read_folder(folder)[0]
    (prediction,) = model.predict(sample.cloud, [sample.grasp])
    assert prediction.status == "ok"
    assert "unfamiliar" not in prediction.flags


@pytest.mark.slow
def test_comparing_reports_skills_and_writes_nothing(folder: Path, config: Path, tmp_path, capsys) -> None:
    before = sorted(tmp_path.iterdir())
    assert train(config, folder, "--compare", "random,object", "--json") == 0
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert list(dict.fromkeys(line["split"] for line in lines)) == ["random", "object"]
    assert train(config, folder, "train.epochs=1", "--compare", "random") == 0
    assert "geometry_trees" in capsys.readouterr().out
    assert sorted(tmp_path.iterdir()) == before
