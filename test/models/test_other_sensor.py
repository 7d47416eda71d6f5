# SPDX-License-Identifier: Apache-2.0
"""A model of one sensor and the readings, histories and descriptions of another, or of a changed one."""

import shutil
from dataclasses import replace

import numpy as np
import pytest
from contact_model_builders import edit_card
from other_sensor import USKIN, changed_sensor

from foretouch.errors import FileError, ModelError, TactileError
from foretouch.models import load_model
from foretouch.models.history_keeper import HistoryFile
from foretouch.models.state_space import TrackerParameters
from foretouch.models.touch_model import History
from foretouch.tactile import biotac_touch
from foretouch.types import Touch
from foretouch.types.channels import Channel, Channels
from foretouch_lab.learning.data import load_dataset


def test_a_tare_and_a_touch_of_another_sensor_are_refused_by_name(uskin, tmp_path) -> None:
    model, sample = load_model(uskin[1]), load_dataset(uskin[0]).samples[0]
    changed = changed_sensor(tmp_path, values=[{"name": name, "field": name, "dtype": "int16"} for name in "XYZ"])
    history, biotac = History(model), biotac_touch(np.full(50, 2000.0))
    same_size = Touch(np.full(96, 2000.0), changed.channels)
    with pytest.raises(
        TactileError, match=r"tare: is of biotac_sp \(\w{8}\): not xela_uskin_4x4 \(\w{8} is expected\)"
    ):
        model.predict(sample.cloud, [sample.grasp], tare=biotac)
    with pytest.raises(
        TactileError, match=r"tare: is of xela_uskin_4x4 .* the description of xela_uskin_4x4 has changed"
    ):
        history.tare(same_size, stamp_ns=1)
    with pytest.raises(TactileError, match=r"touched: is of xela_uskin_4x4 .* has changed"):
        history.touched(sample.cloud, sample.grasp, same_size, stamp_ns=1, same_object=True)
    assert history.tracker.evidence(0).readings == 0


def test_the_history_of_a_hand_goes_on_from_its_file_and_that_of_another_sensor_is_refused(uskin, tmp_path) -> None:
    model, samples = load_model(uskin[1]), load_dataset(uskin[0]).samples
    history = History(model)
    for number, sample in enumerate(samples[:3]):
        history.tare(sample.tare, stamp_ns=(2 * number + 1) * 10**9)
        history.touched(sample.cloud, sample.grasp, sample.touch, stamp_ns=(2 * number + 2) * 10**9, same_object=True)
    HistoryFile(tmp_path / "hand", "left").write(history)
    again = History.load(tmp_path / "hand", model)
    asked = [samples[4].grasp]
    (one,), (other,) = (
        model.predict(samples[4].cloud, asked, history=part.at(9 * 10**9, same_object=True))
        for part in (history, again)
    )
    np.testing.assert_array_equal(one.value.values, other.value.values)
    biotac = load_model("contact-v3")
    with pytest.raises(FileError, match=r"hand: sensor: is of xela_uskin_4x4 \(\w{8}\): not biotac_sp"):
        History.load(tmp_path / "hand", biotac)
    HistoryFile(tmp_path / "other", "left").write(History(biotac))
    with pytest.raises(FileError, match=r"other: sensor: is of biotac_sp \(\w{8}\): not xela_uskin_4x4"):
        History.load(tmp_path / "other", model)


def test_a_card_whose_description_has_changed_is_refused(uskin, tmp_path) -> None:
    shutil.copytree(uskin[1].parent, tmp_path / "model")
    card = tmp_path / "model" / uskin[1].name
    edit_card(card, sensor={**USKIN.to_mapping(), "grasp": ["FF", "TH"]})
    with pytest.raises(ModelError, match=r"uskin.json: sensor_sha256: is of xela_uskin_4x4 .* has changed"):
        load_model(card)
    edit_card(card, sensor={"name": "?"})
    with pytest.raises(ModelError, match=r"uskin.json: sensor: name: '\?' is not"):
        load_model(card)
    edit_card(card, sensor=...)  # as of the BioTac SP
    with pytest.raises(ModelError, match=r"uskin.json: sensor_sha256: is of xela_uskin_4x4 .* not biotac_sp"):
        load_model(card)
    edit_card(card, sensor_name=..., sensor_sha256=...)
    with pytest.raises(ModelError, match=r"ranges: x_th: unknown; known: pdc_th"):
        load_model(card)


def test_of_many_values_the_modalities_are_decomposed_one_by_one(rng: np.random.Generator) -> None:
    one = Channel("P", 101, "N", 0.0, 5.0, 1, tared=False, noise=0.01, resolution=0.01)
    channels = Channels("large", "", ("left", "right"), (one, replace(one, name="S")))
    factors = rng.normal(size=(channels.size, 5))
    between, within = factors @ factors.T + np.eye(channels.size), rng.uniform(1.0, 2.0, channels.size)
    shrinkage, factor = np.ones(channels.size), np.ones(4)
    found = TrackerParameters.from_calibration(
        channels, (between, between), (within, within), (shrinkage, shrinkage), factor
    )
    rebuilt = (found.basis * found.object[0]) @ found.basis.T
    same = channels.modality_of_value[:, None] == channels.modality_of_value
    np.testing.assert_allclose(rebuilt, np.where(same, between, 0.0), atol=1e-9)
    np.testing.assert_allclose((found.basis * found.noise[0]) @ found.basis.T, np.diag(within), atol=1e-9)
