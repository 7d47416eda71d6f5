# SPDX-License-Identifier: Apache-2.0
"""The folder of a training run is accepted wherever a model is, and refused in one line where it holds no model."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from foretouch.cli.main import main
from foretouch.models import load_model

Call = Callable[..., Any]
CONFIG = Path(__file__).parents[2] / "config"
TINY = [
    *("model.tnet=false", "model.trunk_widths=[8,16]", "model.head_widths=[16]", "model.n_points=64"),
    *("train.epochs=1", "train.batch_size=4", "name=tiny"),
]


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("simulated") / "store"
    words = ["simulate", str(CONFIG / "scenes/clean.yaml"), "-n", "24", "-o", str(out), "--workers", "1", "--no-sheet"]
    assert main([*words, "--json"]) == 0
    return out


@pytest.fixture(scope="module")
def run(simulated: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of `foretouch train`, with all four modalities."""
    out = tmp_path_factory.mktemp("train") / "run"
    words = ["train", str(CONFIG / "train/touchnet-v1.yaml"), f"data={simulated}", *TINY, "-o", str(out), "--json"]
    assert main(words) == 0
    return out


def test_models_lists_the_model_of_a_run(call: Call, run: Path) -> None:
    (record,) = call("models", run, "--json").records
    assert (record["status"], record["name"], record["sha256"]) == ("ok", "tiny", load_model(run).sha256)
    assert "tiny.safetensors" in record["files"]
    assert "state.safetensors" not in record["files"]


def test_predict_with_a_run_is_predict_with_its_card(call: Call, run: Path, files: Path) -> None:
    by_run, by_card = (
        call("predict", files / "object.pcd", "--model", model, "--json").records[0]
        for model in (run, run / "tiny.json")
    )
    assert by_run["model"]["name"] == "tiny"
    assert by_run["predictions"] == by_card["predictions"]


def test_evaluate_of_a_run_is_evaluate_of_its_card(call: Call, run: Path, simulated: Path) -> None:
    by_run, by_card = (call("evaluate", model, simulated, "--json").records[0] for model in (run, run / "tiny.json"))
    assert by_run.pop("model") == str(run)
    assert by_card.pop("model") == str(run / "tiny.json")
    assert by_run == by_card


@pytest.mark.ros
def test_the_node_loads_the_model_of_a_run(run: Path) -> None:
    pytest.importorskip("rclpy")
    from foretouch.ros.touch.predictor import Predictor

    predictor = Predictor(str(run))
    assert predictor.fault == ""
    assert predictor.model is not None
    assert predictor.model.name == "tiny"


def test_an_unfinished_run_is_refused_in_one_line_by_each_command(
    call: Call, run: Path, simulated: Path, files: Path, tmp_path: Path
) -> None:
    for name in ("config.yaml", "log.jsonl", "state.safetensors"):
        (tmp_path / name).write_bytes((run / name).read_bytes())
    for words in (("predict", files / "object.pcd", "--model", tmp_path), ("evaluate", tmp_path, simulated)):
        answer = call(*words)
        assert (answer.status, answer.err.count("\n")) == (1, 1)
        assert f"{tmp_path}: is an unfinished run without a model card" in answer.err
    (record,) = call("models", tmp_path, "--json").records
    assert f"{tmp_path}: is an unfinished run" in record["reason"]
