# SPDX-License-Identifier: Apache-2.0
"""A run on disk: it resumes bit for bit, keeps its last good state, and refuses to become another run."""

import json

import numpy as np
import pytest
import torch
from every_case import every_refusal
from run_builders import MODEL, quiet, run_config, stop_after
from safetensors.torch import load_file

from foretouch.errors import DatasetError, FileError, ForetouchError
from foretouch.tactile import P2_RANGES
from foretouch_lab.learning.data import Dataset, labels_of
from foretouch_lab.learning.evaluation.baselines import training_mean
from foretouch_lab.learning.evaluation.evaluate import evaluate_model
from foretouch_lab.learning.evaluation.metrics import score
from foretouch_lab.learning.training.run import train_run
from foretouch_lab.learning.training.run_folder import LOG_FILE, STATE_FILE, read_state, write_state


@pytest.mark.parametrize("method", ["supervised", "srgan"])
def test_a_stopped_run_goes_on_to_the_same_weights(data, tmp_path, method: str) -> None:
    chosen = run_config(method=method, split="labels/T50")
    whole = train_run(chosen, data, tmp_path / "whole", quiet)
    with pytest.raises(KeyboardInterrupt):
        train_run(chosen, data, tmp_path / "cut", stop_after(1))
    assert not (tmp_path / "cut" / "tiny.json").exists()
    cut = train_run(chosen, data, tmp_path / "cut", quiet, resume=True)
    one, two = load_file(whole.with_suffix(".safetensors")), load_file(cut.with_suffix(".safetensors"))
    assert all(torch.equal(one[key], two[key]) for key in one)
    assert json.loads(whole.read_text())["sha256"] == json.loads(cut.read_text())["sha256"]
    logs = [(tmp_path / name / LOG_FILE).read_text() for name in ("whole", "cut")]
    assert logs[0] == logs[1]
    assert [json.loads(line)["epoch"] for line in logs[0].splitlines()] == [0, 1, 2, 3]


def test_the_result_is_that_of_the_test_samples_with_the_baselines_beside_it(data, tmp_path) -> None:
    said: list[dict] = []
    card_path = train_run(run_config(split="labels/T30"), data, tmp_path / "run", said.append)
    result, card = said[-1], json.loads(card_path.read_text())
    (part,) = data.parts("labels/T30")
    assert result["samples"] == len(part.test)
    assert set(result["scores"]) == {
        "model",
        "training_mean",
        "object_mean",
        "object_time_trees",
        "geometry_trees",
        "geometry_trees_pose_free",
    }
    assert set(result["scores"]["model"]) == {"PDC_TH"}
    labels = labels_of(data.samples)
    train, test = (labels[index] for index in (part.train, part.test))
    mean = np.tile(train.mean(0), (len(test), 1))
    assert result["scores"]["training_mean"]["PDC_TH"]["rmse"] == pytest.approx(
        score(mean, test, mean, P2_RANGES.ranges)["PDC_TH"]["rmse"]
    )
    assert card["skill"]["labels/T30"] == result["scores"]["model"]
    assert card["data"]["sha256"] == data.sha256
    assert card["split"]["train"] == len(part.train)


def test_splits_that_do_not_fit_are_named(data, tmp_path) -> None:
    out = tmp_path / "run"
    cases = (
        ("no sample is unlabelled; choose a split that withholds labels", {"method": "srgan"}),
        ("'time' has 5 parts; choose one: time/block 0", {"split": "time"}),
        ("'labels/T20' is not one of labels/T10, labels/T30", {"split": "labels/T20"}),
        ("'day' is not one of random, object, time, labels", {"split": "day"}),
    )
    every_refusal(ForetouchError, cases, lambda changes: train_run(run_config(**changes), data, out, quiet))
    assert not out.exists()
    with pytest.raises(DatasetError, match=rf"{data.samples[0].id}: channels: the model needs xyz\+rgb"):
        train_run(run_config(model={**MODEL, "channels": "xyz+rgb"}), data, out, quiet)


@pytest.mark.timeout(20)
def test_a_damaged_state_is_named(tmp_path) -> None:
    file = tmp_path / STATE_FILE
    with pytest.raises(FileError, match="No such file"):
        read_state(file)
    write_state(
        file, {"a": torch.ones(300), "b": torch.zeros((), dtype=torch.bfloat16)}, {"epoch": 1, "x": 0.1, "log": []}
    )
    read_state(file)
    content = bytearray(file.read_bytes())
    for at in (len(content) - 500, content.index(b"epoch") + 9):  # a bit of a weight; of the number of the epoch
        damaged = bytearray(content)
        damaged[at] ^= 2
        file.write_bytes(damaged)
        with pytest.raises(FileError, match=r"state.safetensors: sha256: .* is not .*: the file was changed"):
            read_state(file)
    file.write_bytes(content[:-40])
    with pytest.raises(FileError, match="is not a state of training"):
        read_state(file)


def test_an_evaluation_leaves_out_the_samples_that_the_model_was_trained_on(data, tmp_path) -> None:
    other = Dataset("another name", data.samples, "another hash", data.splits)
    (first,) = data.parts("random/random 0")
    card = train_run(run_config(split="random/random 0", name=""), data, tmp_path / "part", quiet)
    assert json.loads(card.read_text())["name"] == "part"  # that of its folder
    result = evaluate_model(card, other, "random", baselines={"training_mean": training_mean})
    assert (result["samples"], result["excluded"]) == (len(first.test), len(data.samples) - len(first.test))
    assert (result["scored"], result["same_data"]) == ("held_out", True)
    every = evaluate_model(card, other, "random", baselines={}, training_scores=True)
    assert (every["samples"], every["scored"], every["excluded"]) == (len(data.samples), "training_samples", 0)

    card = train_run(run_config(), data, tmp_path / "whole", quiet)
    with pytest.raises(DatasetError, match=r"none is held out; train with release=true .* or split='random/random 0'"):
        evaluate_model(card, other, "random", baselines={})
    unlisted = json.loads(card.read_text())
    del unlisted["data"]["sample_hashes"]
    card.write_text(json.dumps(unlisted))
    assert evaluate_model(card, other, "random", baselines={})["same_data"] is None  # it cannot tell
    with pytest.raises(DatasetError, match="none is held out"):  # the hash of these very data is in its card
        evaluate_model(card, data, "random", baselines={})


@pytest.mark.slow
def test_a_contact_model_has_intervals_and_one_object_alone_no_calibration(data, tmp_path) -> None:
    said: list[dict] = []
    part = data.parts("object")[0].name
    run = run_config(method="contact", split=f"object/{part}", contact={"trees": 5})
    card = train_run(run, data, tmp_path / "run", said.append)
    assert said[-1]["status"] == "done"
    row = said[-1]["scores"]["model"]["PDC_TH"]
    assert 0.0 <= row["coverage90"] <= 1.0
    again = train_run(run, data, tmp_path / "run", quiet, resume=True)
    assert json.loads(again.read_text())["sha256"] == json.loads(card.read_text())["sha256"]
    name = data.samples[0].object
    alone = Dataset("alone", tuple(s for s in data.samples if s.object == name), "sha", {})
    card = train_run(run_config(method="contact", contact={"trees": 5}), alone, tmp_path / "alone", quiet)
    card_content = json.loads(card.read_text())
    assert card_content["calibration"] is None
    assert card_content["limits"][0].startswith("No calibration: ")
