# SPDX-License-Identifier: Apache-2.0
"""The models that come with the package."""

from importlib import resources
from pathlib import Path

import numpy as np
import pytest
from contact_model_builders import scaled
from recording_builders import read_folder

from foretouch.dataset.vision2tactile import folder_sha256
from foretouch.models.registry import DEFAULT_MODEL, available_models, load_model
from foretouch.tactile import MODALITIES, columns
from foretouch.types import Grasp


def test_the_default_is_first_all_load_and_cards_hold_what_they_must(can, make_grasps) -> None:
    assert available_models()[0] == load_model().name == load_model("default").name == DEFAULT_MODEL
    folder = Path(str(resources.files("foretouch.models"))) / "weights"
    for name in available_models():
        model, card = load_model(name), load_model(name).card
        assert model.name == name
        assert {"known", "new"} <= set(card["calibration"]["regimes"])
        assert any("cannot exceed 89%" in line for line in card["limits"])  # 8 of 9
        assert "not redistributed" in card["data"]["licence"]
        assert len(card["data"]["sha256"]) == 64
        for table in (card["skill"], *card["baselines"].values()):
            assert set(table) == {"random", "time", "object"}
            assert all(set(scores) == set(MODALITIES) for scores in table.values())
        assert {"training_mean", "object_mean", "object_time_trees", "geometry_trees"} == set(card["baselines"])
        files = list(folder.glob(f"{name}*.safetensors"))
        assert len(files) == 2  # weights and calibration
        assert sum(path.stat().st_size for path in files) <= 10_000_000
        values = [one.value for one in model.predict(can, make_grasps(3))]
        assert all(1600 < value.pdc_mf < 2300 and 2500 < value.pdc_th < 3400 for value in values)


def test_objects_of_sizes_far_from_those_of_training_are_flagged_and_get_the_mean(can, make_grasps) -> None:
    for name in available_models():
        model = load_model(name)
        for factor in (0.4, 2.5):
            cloud = scaled(can, factor)
            centre = cloud.xyz.mean(axis=0, dtype=np.float64)
            grasps = [
                Grasp(*(centre + factor * (p - centre) for p in (one.g1, one.g2)), one.rotation)
                for one in make_grasps(3)
            ]
            predictions = model.predict(cloud, grasps)
            assert all("unfamiliar" in p.flags for p in predictions), (name, factor)
            assert np.ptp([p.value.vector() for p in predictions], axis=0).max() < 1.0


@pytest.mark.real_data
def test_it_predicts_its_training_data(real_data: Path) -> None:
    model = load_model()
    samples = read_folder(real_data / "vision2tactile")[::5]
    predictions = [model.predict(sample.cloud, [sample.grasp])[0] for sample in samples]
    assert np.mean(["unfamiliar" in prediction.flags for prediction in predictions]) < 0.1
    predicted = np.array([p.value.vector() for p in predictions])
    actual = np.array([sample.touch.vector() for sample in samples])
    skill = 1.0 - ((predicted - actual) ** 2).mean(axis=0) / actual.var(axis=0)
    for modality in MODALITIES:
        assert skill[columns([modality])].mean() > 0.1, modality
    other = model.predict(samples[0].cloud, [samples[1].grasp])[0]
    assert not np.array_equal(other.value.vector(), predicted[0])  # it looks at the grasp


@pytest.mark.real_data
def test_the_card_names_this_data(real_data: Path) -> None:
    folder = real_data / "vision2tactile"
    card = load_model().card
    if sum(card["data"]["objects"].values()) != len(list(folder.glob("*/*"))):
        pytest.skip("the folder holds other samples than the model was trained on")
    assert folder_sha256(folder) == card["data"]["sha256"]
