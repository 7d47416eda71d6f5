# SPDX-License-Identifier: Apache-2.0
"""The shipping script, whole, on a small made-up folder."""

import json
from pathlib import Path

import numpy as np
import pytest

from foretouch.cloud.io.files import write_cloud
from foretouch.dataset.vision2tactile import folder_sha256, read_folder
from foretouch.learning.training.release import main
from foretouch.models import load_model

CONFIG = """
name: toy
model: {n_points: 32, tnet: false, trunk_widths: [8, 16], head_widths: [8], metric_inputs: true}
train: {epochs: 3, batch_size: 4}
"""


@pytest.fixture
def folder(tmp_path: Path, samples) -> Path:
    """Ten of the made-up samples, written as the recordings are."""
    for name in ("box0", "box1"):
        for sample in [one for one in samples if one.object == name][:5]:
            place = tmp_path / "data" / name / str(sample.stamp_ns // 10**9)
            place.mkdir(parents=True)
            write_cloud(place / "cloud-object.pcd", sample.cloud)
            contacts = np.concatenate([sample.grasp.g1, sample.grasp.g2])
            (place / "best-grasp.txt").write_text(",".join(map(str, contacts)))
            touch = sample.touch
            numbers = [*touch.e_mf, 0, 0, touch.pdc_mf, 0, 0, *touch.e_th, 0, 0, touch.pdc_th, 0, 0]
            (place / "tactile.tac").write_text("," + ",".join(map(str, numbers)))
    return tmp_path / "data"


@pytest.fixture
def config(tmp_path: Path) -> Path:
    path = tmp_path / "toy.yaml"
    path.write_text(CONFIG)
    return path


def test_it_evaluates_trains_and_writes_a_model_that_loads(folder: Path, config: Path, tmp_path, capsys) -> None:
    assert main([str(config), "train.epochs=2", "--data", str(folder), "-o", str(tmp_path / "out")]) == 0
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [line["epoch"] for line in lines if "epoch" in line] == [0, 1]
    model = load_model(tmp_path / "out" / "toy.json")
    card = model.card
    assert card["data"]["sha256"] == folder_sha256(folder)
    assert card["data"]["objects"] == {"box0": 5, "box1": 5}
    assert card["training"]["epochs"] == 2
    for split in ("random", "time", "object"):
        said = next(line for line in lines if line.get("split") == split and line.get("who") == "model")
        assert card["skill"][split]["E_MF"]["skill"] == pytest.approx(said["skill"]["E_MF"], abs=1e-3)
        assert card["baselines"]["training_mean"][split]["PDC_TH"]["skill"] == pytest.approx(0.0, abs=1e-9)
        assert any(line.startswith(f"Split {split}: mean skill") for line in card["limits"])
    sample = read_folder(folder)[0]
    (prediction,) = model.predict(sample.cloud, [sample.grasp])
    assert prediction.status == "ok"
    assert "unfamiliar" not in prediction.flags


def test_a_contact_model_ships_with_its_calibration(folder: Path, tmp_path: Path) -> None:
    config = tmp_path / "contact.yaml"
    config.write_text("name: toy\nmethod: contact\ncontact: {trees: 5}\n")
    assert main([str(config), "--data", str(folder), "-o", str(tmp_path / "out")]) == 0
    model = load_model(tmp_path / "out" / "toy.json")
    assert set(model.card["calibration"]["regimes"]) == {"known", "new"}
    assert any("cannot exceed 67%" in line for line in model.card["limits"])  # 2 of 3
    sample = read_folder(folder)[0]
    (prediction,) = model.predict(sample.cloud, [sample.grasp])
    assert (prediction.lower.vector() < prediction.value.vector()).all()
    assert (prediction.value.vector() < prediction.upper.vector()).all()


def test_known_failures_are_one_line_and_status_one(folder: Path, config: Path, tmp_path, capsys) -> None:
    assert main([str(config), "--data", str(tmp_path / "absent"), "--compare", "random"]) == 1
    assert capsys.readouterr().err == f"{tmp_path / 'absent'}: no such folder\n"
    assert main([str(config), "train.epoch=2", "--data", str(folder), "--compare", "random"]) == 1
    assert "train.epoch: unknown setting" in capsys.readouterr().err


def test_no_folder_to_write_to_is_wrong_usage(folder: Path, config: Path, capsys) -> None:
    with pytest.raises(SystemExit) as stopped:
        main([str(config), "--data", str(folder)])
    assert stopped.value.code == 2
