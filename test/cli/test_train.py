# SPDX-License-Identifier: Apache-2.0
"""`foretouch train` and `foretouch evaluate` on a small simulated dataset."""

from pathlib import Path

import pytest

SCENES = Path(__file__).parents[2] / "config/scenes"
RECIPES = Path(__file__).parents[2] / "config/train"
TINY = ["model.channels=xyz", "model.trunk_widths=[8,16]", "model.head_widths=[16]", "model.tnet=false"]
SHORT = ["model.n_points=64", "srgan.points=64", "srgan.epochs=2", "srgan.batch_size=2"]


@pytest.fixture(scope="module")
def simulated(tmp_path_factory) -> Path:
    from foretouch.cli.main import main

    out = tmp_path_factory.mktemp("simulated") / "store"
    scene = str(SCENES / "clean.yaml")
    assert main(["simulate", scene, "-n", "24", "-o", str(out), "--workers", "1", "--no-sheet", "--json"]) == 0
    return out


def test_train_and_evaluate(call, simulated, tmp_path) -> None:
    words = ["train", RECIPES / "p2_srgan.yaml", f"data={simulated}", *TINY, *SHORT, "-o", tmp_path / "run"]
    answer = call(*words, "--json")
    assert answer.status == 0, answer.err
    *epochs, result = answer.records
    assert [record["epoch"] for record in epochs] == [0, 1]
    assert {"labeled", "unlabeled", "fake", "generator", "total"} == set(epochs[0]["losses"])
    assert result["status"] == "done"
    scored = call("evaluate", result["card"], simulated, "--split", "labels/T50", "--json")
    assert scored.status == 0, scored.err
    (record,) = scored.records
    assert record["PDC_TH"] == result["scores"]["model"]["PDC_TH"]
    assert set(record["PDC_TH"]) == {"rmse", "nrmse", "skill", "coverage90"}
    assert set(record["baselines"]) == {"training_mean", "object_mean", "object_time_trees", "geometry_trees"}
    assert record["same_data"] is True
    by_folder = call("evaluate", tmp_path / "run", simulated, "--split", "labels/T50", "--json")
    assert by_folder.records[0]["PDC_TH"] == record["PDC_TH"]
    again = call(*words, "--json")
    assert again.status == 1
    assert "--resume" in again.err
    assert call(*words, "--json", "--resume").records[-1]["scores"] == result["scores"]


def test_people_get_a_table(call, simulated, tmp_path) -> None:
    answer = call("train", RECIPES / "p2.yaml", f"data={simulated}", *TINY, "train.epochs=1", "train.batch_size=4",
                  "model.n_points=64", "split=random/random 1", "-o", tmp_path / "run")  # fmt: skip
    assert answer.status == 0, answer.err
    assert "geometry_trees" in answer.out
    assert "PDC_TH" in answer.out
    scored = call("evaluate", "default", simulated)
    assert scored.status == 0, scored.err
    assert "E_MF" in scored.out


def test_errors_are_one_line(call, simulated, tmp_path) -> None:
    out = ["-o", tmp_path / "run"]
    unknown = call("train", RECIPES / "p2.yaml", f"data={simulated}", "train.epoch=3", *out)
    assert unknown.status == 1
    assert "train.epoch: unknown setting; known: device, precision, epochs" in unknown.err
    nothing = call("train", RECIPES / "p2.yaml", *out)
    assert "data: is empty; give data=PATH" in nothing.err
    absent = call("evaluate", "default", tmp_path / "none")
    assert absent.status == 1
    assert "does not exist" in absent.err
    assert call("evaluate", tmp_path / "x.json", simulated).err.endswith("no such model card\n")
    assert not (tmp_path / "run").exists()


@pytest.mark.real_data
def test_the_released_model_recognises_its_training_data(call, real_data) -> None:
    folder = real_data / "vision2tactile"
    answer = call("evaluate", "default", folder, "--json")
    assert answer.status == 0, answer.err
    assert answer.records[0]["same_data"] is True
    assert answer.records[0]["PDC_TH"]["skill"] > 0.5  # training samples: its skill on held-out grasps is half of that
