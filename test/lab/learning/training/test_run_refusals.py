# SPDX-License-Identifier: Apache-2.0
"""Errors of a run name file, field and rule, and no earlier result is lost."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from every_case import every_refusal
from run_builders import BASE, MODEL, quiet, run_config
from safetensors.torch import load_file

from foretouch.errors import ConfigError, DatasetError, FileError, ModelError
from foretouch.tactile import biotac_touch
from foretouch.types import Cloud, Sample
from foretouch_lab.learning.data import Dataset
from foretouch_lab.learning.training.run import train_run
from foretouch_lab.learning.training.run_config import RunConfig
from foretouch_lab.learning.training.run_folder import CONFIG_FILE, LOG_FILE, STATE_FILE, read_state
from foretouch_lab.learning.training.supervised import SupervisedTrainer

CONTACT = {"method": "contact", "contact": {"trees": 2}}


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def with_first(data: Dataset, sample: Sample) -> Dataset:
    return replace(data, samples=(sample, *data.samples[1:]))


def test_settings_of_another_method_and_clouds_that_cannot_be_described_are_refused(data, tmp_path) -> None:
    cases = (
        ("train.epochs: has no effect on method 'contact'", {"method": "contact", "train": {"epochs": 3}}),
        ("model.n_points: has no effect on method 'contact'", {"method": "contact", "model": MODEL}),
        ("train.batch_size: has no effect on method 'srgan'", {"method": "srgan", "train": {"batch_size": 3}}),
        ("contact.trees: has no effect on method 'supervised'", {"contact": {"trees": 3}}),
    )
    every_refusal(ConfigError, cases, RunConfig.from_mapping)
    first = data.samples[0]
    few = with_first(data, replace(first, cloud=Cloud(first.cloud.xyz[:3])))
    with pytest.raises(DatasetError, match=rf"{first.id}: .*points"):
        train_run(run_config(**CONTACT), few, tmp_path / "run", quiet)


@pytest.mark.parametrize("method", ["supervised", "contact"])
def test_a_bad_label_is_named_and_the_corrected_data_train_in_the_same_folder(data, tmp_path, method: str) -> None:
    first = data.samples[0]
    faulty = with_first(
        data, replace(first, touch=biotac_touch(np.insert(np.delete(first.touch.values, 1), 1, -22072.0)))
    )
    run = run_config(**{**CONTACT, "method": method})
    with pytest.raises(DatasetError, match=rf"{first.id}: touch: pdc_mf: -22072 is not between 1 and 4095 counts"):
        train_run(run, replace(faulty, sha256="faulty"), tmp_path / "run", quiet)
    assert train_run(run, data, tmp_path / "run", quiet).is_file()


@pytest.mark.parametrize("method", ["supervised", "contact"])
def test_labels_that_do_not_vary_and_a_model_that_cannot_be_read_are_refused(
    data, tmp_path, monkeypatch, method
) -> None:
    touch = data.samples[0].touch
    same = replace(data, samples=tuple(replace(sample, touch=touch) for sample in data.samples), sha256="same")
    run = run_config(**{**CONTACT, "method": method})
    with pytest.raises(DatasetError, match=r"labels: PDC_TH.* the same in all 60 samples.*one reading"):
        train_run(run, same, tmp_path / "run", quiet)
    assert not list(tmp_path.rglob("*.json"))

    def unreadable(card: Path) -> None:
        raise ModelError(f"{card}: between: is not a covariance")

    monkeypatch.setattr("foretouch_lab.learning.training.run.load_model", unreadable)
    if method == "contact":  # the network of these tests predicts one modality alone
        with pytest.raises(DatasetError, match=r"cannot be read: .*is not a covariance; do its labels vary"):
            train_run(run, data, tmp_path / "run2", quiet)
        assert not list((tmp_path / "run2").glob("*.json"))


def test_a_loss_that_is_not_finite_leaves_the_state_before(data, tmp_path, monkeypatch) -> None:
    """The label of one sample becomes a NaN after the first epoch, as a memory fault would do it."""
    healthy = SupervisedTrainer.run_epoch

    def faulty(self: SupervisedTrainer) -> dict[str, float]:
        if self.epoch == 2:
            self._labels[5] = float("nan")
        return healthy(self)

    monkeypatch.setattr(SupervisedTrainer, "run_epoch", faulty)
    every = run_config(train={**BASE["train"], "batch_size": 10})  # six batches: all 60 samples
    with pytest.raises(DatasetError, match="training: loss: is not finite in epoch 2; lower learning_rate"):
        train_run(every, data, tmp_path / "run", quiet)
    tensors, plain = read_state(tmp_path / "run" / STATE_FILE)
    assert plain["epoch"] == 2
    assert all(torch.isfinite(value).all() for value in tensors.values())
    monkeypatch.undo()
    resumed = train_run(every, data, tmp_path / "run", quiet, resume=True)
    whole = train_run(every, data, tmp_path / "whole", quiet)
    one, two = (load_file(card.with_suffix(".safetensors")) for card in (resumed, whole))
    assert all(torch.equal(one[key], two[key]) for key in one)


def test_a_run_resumes_as_it_began_and_the_field_or_tensor_is_named(data, tmp_path) -> None:
    train_run(run_config(), data, tmp_path / "run", quiet)
    train_run(run_config(model={**MODEL, "head_widths": [17]}), data, tmp_path / "other", quiet)
    (tmp_path / "run" / STATE_FILE).write_bytes((tmp_path / "other" / STATE_FILE).read_bytes())
    with pytest.raises(FileError, match=rf"run/{STATE_FILE}: .* size mismatch for head.0.linear.weight"):
        train_run(run_config(), data, tmp_path / "run", quiet, resume=True)
    file = tmp_path / "run" / CONFIG_FILE
    with pytest.raises(ConfigError, match=r"config.yaml: model.head_widths: \[16\] is not \[17\]; a run resumes as it"):
        train_run(run_config(model={**MODEL, "head_widths": [17]}), data, tmp_path / "run", quiet, resume=True)
    with pytest.raises(ConfigError, match=r"config.yaml: data_sha256: .* is not 'other'"):
        train_run(run_config(), replace(data, sha256="other"), tmp_path / "run", quiet, resume=True)
    file.write_text("name: [")
    with pytest.raises(ConfigError, match=r"config.yaml: not YAML"):
        train_run(run_config(), data, tmp_path / "run", quiet, resume=True)


def test_models_of_others_in_the_folder_are_not_written_over(data, tmp_path) -> None:
    card = train_run(run_config(), data, tmp_path / "run", quiet)
    for name in (CONFIG_FILE, STATE_FILE, LOG_FILE):
        (card.parent / name).unlink()
    before = contents(card.parent)
    with pytest.raises(FileError, match="holds a run already"):
        train_run(run_config(), data, tmp_path / "run", quiet)
    assert contents(card.parent) == before
