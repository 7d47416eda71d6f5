# SPDX-License-Identifier: Apache-2.0
"""One network for each modality in one model: the papers' networks as they are trained, served together."""

import json
from pathlib import Path

import numpy as np
import pytest
from experiment_samples import make_samples
from run_builders import MODEL, quiet, run_config
from safetensors.numpy import load_file

import foretouch as ft
from foretouch.errors import ConfigError, DatasetError, FileError, ModelError
from foretouch.tactile import MODALITIES
from foretouch_lab.learning.training.run import train_run

QUICK = {"epochs": 2, "batch_size": 8, "target_scaling": "standardised"}


def config(outputs, **changes):
    return run_config(model={**MODEL, "outputs": outputs}, train=QUICK, **changes)


@pytest.fixture(scope="module")
def parts(data, tmp_path_factory) -> dict[str, Path]:
    """A model folder of one network for each modality."""
    folder = tmp_path_factory.mktemp("parts")
    for name in MODALITIES:
        train_run(config([name]), data, folder / name, quiet)
    return {name: folder / name for name in MODALITIES}


@pytest.fixture(scope="module")
def each(data, tmp_path_factory) -> Path:
    """A calibrated model of one network for each modality."""
    return train_run(config("each", calibrate=True), data, tmp_path_factory.mktemp("each") / "m", quiet)


def test_each_network_is_the_one_that_is_trained_alone(each, parts) -> None:
    together = load_file(each.with_suffix(".safetensors"))
    for name, folder in parts.items():
        alone = load_file(folder / "tiny.safetensors")
        own = {key.removeprefix(f"{name}/"): value for key, value in together.items() if key.startswith(f"{name}/")}
        assert own.keys() == alone.keys()
        assert all(np.array_equal(own[key], alone[key]) for key in alone)
    assert [path.name for path in sorted(each.parent.glob("*/log.jsonl"))] == ["log.jsonl"] * 4


def test_a_model_of_four_networks_has_intervals_and_adapts(each, data) -> None:
    model, sample, other = ft.load_model(each.parent), data.samples[0], data.samples[1]
    before = model.predict(sample.cloud, [sample.grasp])
    assert before.ok.all()
    assert np.isfinite([before.lower, before.upper]).all()
    assert (before.lower < before.value).all()
    hand = ft.History(model)
    reading = ft.Touch(before.value[0] + 30.0, before.channels)
    hand.touched(sample.cloud, sample.grasp, reading, stamp_ns=10**18)
    after = hand.predict(other.cloud, [other.grasp], stamp_ns=10**18 + 1, same_object=True)
    assert after[0].reference == "touches"
    assert (after.value - model.predict(other.cloud, [other.grasp]).value).mean() > 5.0


def test_networks_that_exist_are_joined_and_calibrated_on_other_grasps(parts, data, tmp_path) -> None:
    names = ",".join(str(folder) for folder in parts.values())
    joined, sample = ft.load_model(names), data.samples[3]
    counts = joined.estimate(sample.cloud, [sample.grasp]).counts
    alone = train_run(config("each", calibrate=False), data, tmp_path / "each", quiet)
    assert np.array_equal(ft.load_model(alone).estimate(sample.cloud, [sample.grasp]).counts, counts)
    assert np.isnan(joined.predict(sample.cloud, [sample.grasp]).lower).all()
    with pytest.raises(DatasetError, match="was trained on all of its samples; calibrate it on others"):
        ft.calibrate(joined, data.samples)
    calibrated = ft.calibrate(joined, make_samples(6, 5), name="four")
    again = ft.load_model(calibrated.save(tmp_path / "four"))
    predictions = again.predict(sample.cloud, [sample.grasp])
    assert np.array_equal(predictions.value.ravel(), counts.ravel())
    assert np.isfinite([predictions.lower, predictions.upper]).all()


@pytest.mark.parametrize(
    ("chosen", "message"),
    [
        (
            MODALITIES[:3],
            "outputs: E_MF: not predicted by this network; train with model.outputs=each, or join networks",
        ),
        ((*MODALITIES, "E_TH"), "outputs: E_TH: predicted by two networks; leave one out"),
    ],
)
def test_networks_that_do_not_fit_together_are_refused(parts, chosen, message: str) -> None:
    with pytest.raises(ModelError, match=message):
        ft.load_model(",".join(str(parts[name]) for name in chosen))
    with pytest.raises(ModelError, match="kind: contact cannot be joined"):
        ft.load_model(f"contact-v3,{parts['E_TH']}")


def test_a_stopped_training_of_several_networks_goes_on_to_the_same_weights(each, data, tmp_path) -> None:
    stopped, epochs = tmp_path / "m", []

    def stop(record) -> None:
        epochs.append(record)
        if (record.get("network"), record.get("epoch")) == ("PDC_MF", 0):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train_run(config("each"), data, stopped, stop)
    assert {record["network"] for record in epochs} == {"PDC_TH", "PDC_MF"}
    with pytest.raises(FileError, match="holds a run already; --resume continues it"):
        train_run(config("each"), data, stopped, quiet)
    card = train_run(config("each"), data, stopped, quiet, resume=True)
    assert json.loads(card.read_text())["sha256"] == json.loads(each.read_text())["sha256"]


def test_each_is_all_modalities_and_nothing_beside_them() -> None:
    with pytest.raises(ConfigError, match="names modalities beside each, which is all of them"):
        config(["each", "E_TH"])
