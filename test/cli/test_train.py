# SPDX-License-Identifier: Apache-2.0
"""`foretouch train` and `evaluate` on a small simulated dataset, and the folder of a run wherever a model is taken."""

from pathlib import Path

import pytest

from foretouch.cli.main import main
from foretouch.models import available_models, load_model

CONFIG = Path(__file__).parents[2] / "config"
SMALL = ("model.trunk_widths=[8,16]", "model.head_widths=[16]", "model.tnet=false", "model.n_points=64")


@pytest.fixture(scope="module")
def simulated(tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("simulated") / "store"
    words = ["simulate", str(CONFIG / "scenes/clean.yaml"), "-n", "24", "-o", str(out), "--workers", "1", "--no-sheet"]
    assert main([*words, "--json"]) == 0
    return out


@pytest.fixture(scope="module")
def run(simulated, tmp_path_factory) -> Path:
    """A run of `foretouch train`, with all four modalities."""
    out = tmp_path_factory.mktemp("train") / "run"
    words = ["train", str(CONFIG / "train/touchnet-v1.yaml"), f"data={simulated}", *SMALL, "-o", str(out), "--json"]
    assert main([*words, "train.epochs=1", "train.batch_size=4", "name=tiny"]) == 0
    return out


@pytest.mark.slow
def test_train_and_evaluate(call, simulated, tmp_path) -> None:
    short = ("model.channels=xyz", "srgan.points=64", "srgan.epochs=2", "srgan.batch_size=2")
    recipe = CONFIG / "train/p2_srgan.yaml"
    words = ["train", recipe, f"data={simulated}", *SMALL, *short, "-o", tmp_path / "run", "--json"]
    answer = call(*words)
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
    assert set(record["baselines"]) == {
        "training_mean",
        "object_mean",
        "object_time_trees",
        "geometry_trees",
        "geometry_trees_pose_free",
    }
    assert (record["same_data"], record["excluded"], record["scored"]) == (False, 0, "held_out")
    again = call(*words)
    assert again.status == 1
    assert "--resume" in again.err
    assert call(*words, "--resume").records[-1]["scores"] == result["scores"]


def test_errors_are_one_line_and_so_is_an_unfinished_run(call, simulated, tmp_path, run, files) -> None:
    recipe, out = CONFIG / "train/p2.yaml", ("-o", tmp_path / "run")
    for words, line in (
        (("train", recipe, f"data={simulated}", "train.epoch=3", *out), "train.epoch: unknown setting; known: device"),
        (("train", recipe, *out), "data: is empty; give data=PATH"),
        (("evaluate", "default", tmp_path / "none"), "does not exist"),
        (("evaluate", tmp_path / "x.json", simulated), "no such model card"),
    ):
        call(*words).check_refused(line)
    assert not (tmp_path / "run").exists()
    for name in ("config.yaml", "log.jsonl", "state.safetensors"):
        (tmp_path / name).write_bytes((run / name).read_bytes())
    for words in (("predict", files / "object.pcd", "--model", tmp_path), ("evaluate", tmp_path, simulated)):
        call(*words).check_refused(f"{tmp_path}: is an unfinished run without a model card")
    (record,) = call("models", tmp_path, "--json").records
    assert f"{tmp_path}: is an unfinished run" in record["reason"]


@pytest.mark.slow
def test_a_run_is_used_as_its_card(call, run, simulated, files) -> None:
    (record,) = call("models", run, "--json").records
    assert (record["status"], record["name"], record["sha256"]) == ("ok", "tiny", load_model(run).sha256)
    assert "tiny.safetensors" in record["files"]
    assert "state.safetensors" not in record["files"]
    models = (run, run / "tiny.json")
    by_run, by_card = (call("predict", files / "object.pcd", "--model", model, "--json").records[0] for model in models)
    assert by_run["model"]["name"] == "tiny"
    assert by_run["predictions"] == by_card["predictions"]
    (scored,) = call("evaluate", run, simulated, "--training-scores", "--json").records
    assert (scored["model"], scored["scored"]) == (str(run), "training_samples")


@pytest.mark.slow
@pytest.mark.real_data
def test_released_models_recognise_their_training_data_in_a_rebuilt_store(call, real_data, tmp_path) -> None:
    assert call("dataset", "import", real_data / "vision2tactile", "-o", tmp_path / "imported").status == 0
    assert call("dataset", "build", tmp_path / "imported", "-o", tmp_path / "store").status == 0
    for model in available_models():
        if sum(load_model(model).card["data"].get("objects", {}).values()) != 400:
            continue
        answer = call("evaluate", model, tmp_path / "store", "--split", "object", "--json")
        assert answer.status == 0, answer.err
        (record,) = answer.records
        assert (record["scored"], record["same_data"], record["excluded"]) == ("cross_validation", True, 400)
        assert abs(record["PDC_TH"]["skill"]) < 0.1  # .85 on its training samples
        assert record["PDC_TH"]["skill"] == load_model(model).card["skill"]["object"]["PDC_TH"]["skill"]
    table = call("evaluate", "default", tmp_path / "store")
    assert "samples by cross-validation" in " ".join(table.out.split())
    assert "inside" not in table.out  # the card has none
