# SPDX-License-Identifier: Apache-2.0
"""Models of other sensors than the BioTac SP: what they learn, what their card states, and what is refused."""

import json
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from other_sensor import USKIN, changed_sensor, readings, train_on, write_readings
from run_builders import quiet, run_config

from foretouch.errors import ConfigError, TactileError
from foretouch.models import load_model
from foretouch.tactile import touch_faults
from foretouch_lab.learning.data import channels_of, load_dataset
from foretouch_lab.learning.evaluation.evaluate import evaluate_model
from foretouch_lab.learning.prequential import replay_model
from foretouch_lab.learning.training.calibration import rest_level
from foretouch_lab.learning.training.run import train_run


def test_a_model_of_another_sensor_states_it_and_predicts_its_readings(uskin) -> None:
    store, path = uskin
    card, model, data = json.loads(path.read_text()), load_model(path), load_dataset(store)
    assert (card["sensor"], card["sensor_name"]) == (USKIN.to_mapping(), "xela_uskin_4x4")
    assert card["sensor_sha256"] == model.sensor.sha256 == data.sensor.sha256 == USKIN.sha256
    assert card["ranges"]["z_th"] == [0.0, 65535.0]
    assert "ranges" not in card["config"]
    assert card["summary"].startswith("X_TH, X_FF, Y_TH, Y_FF, Z_TH, Z_FF, contact")
    for sample in data.samples[::5]:
        (one,) = model.predict(sample.cloud, [sample.grasp], tare=sample.tare)
        assert one.value.channels == one.lower.channels == USKIN.channels
        assert touch_faults(one.value) == ()
        inside = (one.lower.values <= sample.touch.values) & (sample.touch.values <= one.upper.values)
        assert inside.mean() > 0.8, sample.id


def test_a_dataset_of_another_sensor_or_of_a_changed_description_is_refused_by_name(uskin, data, tmp_path) -> None:
    store, path = uskin
    other = changed_sensor(tmp_path, array={"rows": 4, "cols": 4, "size": [0.005, 0.005]})
    changed = load_dataset(write_readings(tmp_path / "changed", other, 2, 3))
    with pytest.raises(TactileError, match=r"boxes: is of biotac_sp \(\w{8}\): not xela_uskin_4x4 \("):
        evaluate_model(path, data, "object")
    with pytest.raises(
        TactileError, match=r"changed: is of xela_uskin_4x4 \(\w{8}\): the description of .* has changed"
    ):
        evaluate_model(path, changed, "random")
    with pytest.raises(TactileError, match=rf"{changed.samples[0].id}: is of xela_uskin_4x4 .* has changed"):
        replay_model(load_model(path), changed.samples)
    with pytest.raises(TactileError, match=r"touch: is of biotac_sp .* not xela_uskin_4x4"):
        channels_of([*load_dataset(store).samples, *data.samples])


def test_networks_and_ranges_of_the_papers_refuse_another_sensor_by_name(uskin, tmp_path) -> None:
    rule = "method: supervised trains networks for biotac_sp, and store is of xela_uskin_4x4; use contact"
    with pytest.raises(ConfigError, match=rule):
        train_run(run_config(), load_dataset(uskin[0]), tmp_path / "run", quiet)
    ranges = run_config(method="contact", contact={"ranges": {"pdc_th": [0.0, 4000.0]}})
    with pytest.raises(ConfigError, match=r"contact.ranges: are of biotac_sp, and store is of xela_uskin_4x4"):
        train_run(ranges, load_dataset(uskin[0]), tmp_path / "run", quiet)
    assert not (tmp_path / "run").exists()


def test_a_rest_level_that_was_not_read_is_on_the_side_that_contact_leaves(samples, tmp_path) -> None:
    shares = {"rise": 0.01, "fall": 0.95, "both": 0.5}
    values = [{"name": one, "field": one, "contact": one, "rest": "tare", "dtype": "int16"} for one in shares]
    channels = changed_sensor(tmp_path, values=values).channels
    bare = [replace(reading, tare=None) for reading in readings(list(samples), channels)]
    (rest, recorded), labels = rest_level(bare), np.array([one.touch.values for one in bare])
    assert not recorded
    for name, share in shares.items():
        columns = channels.columns([f"{name}_{finger}" for finger in channels.fingers])
        assert_array_equal(rest[columns], np.quantile(labels[:, columns], share, axis=0), err_msg=name)


@pytest.mark.slow
def test_forces_in_newtons_whose_taxels_mostly_read_zero_are_learned_and_have_narrow_intervals(tmp_path) -> None:
    force = {"name": "normal", "field": "values", "unit": "N", "contact": "rise", "rest": "zero", "range": [0.0, 50.0]}
    array = {"rows": 3, "cols": 3, "size": [0.001, 0.001]}
    sensor = changed_sensor(tmp_path, "tacsl_20x25", values=[force], array=array)
    store = write_readings(tmp_path / "store", sensor, zero=(0, 8))
    path, data = train_on(store, tmp_path / "forces"), load_dataset(store)
    model = load_model(path)
    (one,) = model.predict(data.samples[0].cloud, [data.samples[0].grasp])
    half = (one.upper.values - one.lower.values) / 2.0
    assert_array_equal(one.value.values[[0, 8]], 0.0)
    assert model.card["calibration"]["rest"] == "zero by the sensor's description"
    assert half[[0, 8]].max() < 1e-3
    assert half.max() < 10.0
    scores = evaluate_model(path, data, "object", training_scores=True)["scores"]["model"]
    assert min(row["skill"] for row in scores.values()) > 0.0  # of the taxels that are ever touched
