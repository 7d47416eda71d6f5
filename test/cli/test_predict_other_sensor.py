# SPDX-License-Identifier: Apache-2.0
"""`train`, `predict` and `evaluate` for another sensor than the BioTac SP: its JSON, its tares, and what is refused."""

import json

import numpy as np
import pytest
from calibrated_models import save_calibrated_contact
from every_case import every_case
from other_sensor import USKIN
from run_builders import write_store

from foretouch.models import load_model
from foretouch_lab.learning.data import load_dataset

MODALITIES = USKIN.channels.modalities


@pytest.fixture(scope="module")
def biotac(tmp_path_factory) -> tuple[str, str]:
    """A store of readings of the BioTac SP, and a model of it."""
    from experiment_samples import make_samples

    folder = tmp_path_factory.mktemp("biotac")
    return str(write_store(folder / "cans", make_samples(2, 3))), save_calibrated_contact(folder)


def test_predictions_are_by_the_modalities_of_the_sensor_in_order(call, uskin) -> None:
    store, path = uskin
    lines = [json.loads(line) for line in call("predict", store, "--model", path, "--json").out.splitlines()]
    model, data = load_model(path), load_dataset(store)
    for line, sample in zip(lines, data.samples, strict=True):
        (record,) = line["predictions"]
        (wanted,) = model.predict(sample.cloud, [sample.grasp])
        for end in ("value", "lower", "upper"):
            read = np.concatenate([record[name][end] for name in MODALITIES])
            np.testing.assert_array_equal(read, getattr(wanted, end).values)
        assert [key for key in record if key in MODALITIES] == list(MODALITIES)
        assert line["model"]["sensor"] == "xela_uskin_4x4"
    table = call("predict", store, "--model", path).out
    assert all(name in table for name in MODALITIES)


def test_readings_and_models_of_another_sensor_are_refused_in_one_line(call, uskin, biotac, tmp_path) -> None:
    (store, path), (cans, contact) = uskin, biotac
    samples = load_dataset(store).samples
    tare = tmp_path / "rest.json"
    tare.write_text(json.dumps({"pdc_th": 2000.0, "pdc_mf": 2000.0, "e_th": [3000.0] * 24, "e_mf": [3000.0] * 24}))
    of_uskin, of_biotac = "is of xela_uskin_4x4 (", "is of biotac_sp ("
    predict = ("predict", store, "--model")

    def check(words: tuple[object, ...], rule: str) -> None:
        answer = call(*words)
        assert answer.status != 0
        lines = [line for line in answer.err.splitlines() if line.startswith("foretouch: ")]
        assert len(lines) == (len(samples) if "sample" in words else 1)
        assert rule in lines[0]

    cases = [
        ((*predict, contact, "--tare", "sample"), f"tare: {of_uskin}"),
        ((*predict, contact, "--touched", store), f"--touched: {store}: {of_uskin}"),
        ((*predict, path, "--history", cans), f"--history: {cans}: {of_biotac}"),
        (("predict", store, "--model", contact, "--prequential"), f"{store}: {of_uskin}"),
        ((*predict, path, "--tare", tare), "is not a reading of xela_uskin_4x4: it must hold x_th, x_ff, y_th,"),
        (("evaluate", contact, store), f"store: {of_uskin}"),
        (("train", "supervised", f"data={store}", "-o", tmp_path / "net"), "trains networks for biotac_sp"),
    ]
    every_case(cases, check)
