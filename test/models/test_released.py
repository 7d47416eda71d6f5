# SPDX-License-Identifier: Apache-2.0
"""The models that come with the package."""

from importlib import resources
from pathlib import Path

import numpy as np
import pytest
from contact_model_builders import scaled
from recording_builders import read_folder

from benchmarks.common import ROOT, read_csv
from benchmarks.demo.bench import demo_rows, demo_run
from foretouch.dataset.formats.vision2tactile import folder_sha256
from foretouch.errors import ModelError
from foretouch.models.registry import DEFAULT_MODEL, available_models, load_model
from foretouch.models.touch_model import History
from foretouch.tactile import BIOTAC, MODALITIES, biotac_touch
from foretouch.types import Grasp
from foretouch_lab.simulation.scene import load_scene


def test_the_default_is_first_all_load_and_cards_hold_what_they_must(can, make_grasps) -> None:
    assert available_models()[0] == load_model().name == load_model("default").name == DEFAULT_MODEL
    folder = Path(str(resources.files("foretouch.models"))) / "weights"
    assert {name: load_model(name).simulated for name in available_models()} == {
        "contact-v3": False, "simulated": True,
    }  # fmt: skip
    for name in available_models():
        model, card = load_model(name), load_model(name).card
        assert model.name == name
        assert {"known", "new"} <= set(card["calibration"]["regimes"])
        left_out = card["calibration"]["regimes"]["new"]["objects"]
        assert left_out == (3 if model.simulated else len(card["data"]["objects"]))
        assert any(f"cannot exceed {left_out / (left_out + 1):.0%}" in line for line in card["limits"])
        for (
            group,
            half,
        ) in model.calibration.unread_half_widths.items():  # conformal, by the coverage that the card states
            np.testing.assert_allclose(half, model.calibration.groups[group].half_width, rtol=0.11)
        if model.simulated:
            assert card["data"]["recipe"] == "foretouch train simulated data=simulated_hand release=true"
            assert card["data"]["source"] == "foretouch simulate config/scenes/simulated_hand.yaml -n 1200"
            assert any(line.startswith("For the simulated hand only") for line in card["limits"])
        else:
            assert "not redistributed" in card["data"]["licence"]
        assert len(card["data"]["sha256"]) == 64
        for table in (card["skill"], *card["baselines"].values()):
            assert set(table) == {"random", "time", "object"}
            assert all(set(scores) == set(MODALITIES) for scores in table.values())
        baselines = {"training_mean", "object_mean", "object_time_trees", "geometry_trees"}
        assert baselines <= set(card["baselines"]) <= {*baselines, "geometry_trees_pose_free"}
        files = list(folder.glob(f"{name}*.safetensors"))
        assert len(files) == 2  # weights and calibration
        assert sum(path.stat().st_size for path in files) <= 3_000_000
        values = [one.value for one in model.predict(can, make_grasps(3))]
        assert all(1600 < value["PDC_MF"][0] < 2300 and 2500 < value["PDC_TH"][0] < 3400 for value in values)


def test_a_history_serves_another_load_of_its_model_and_no_other_model(can, make_grasps) -> None:
    models, grasps = [load_model(), load_model(), load_model("simulated")], make_grasps(2)
    history = History(models[0])
    history.tare(biotac_touch(models[0].calibration.rest.round()), stamp_ns=0)
    at = history.at(10**9, same_object=False, tared=True)
    own, twin = (model.predict(can, grasps, history=at) for model in models[:2])
    np.testing.assert_array_equal(twin.value, own.value)
    assert twin.reference.tolist() == ["tare", "tare"]
    with pytest.raises(ModelError, match="simulated: history: is of another model"):
        models[2].predict(can, grasps, history=at)


def test_the_simulated_model_knows_its_scene() -> None:
    """Its training scene is the one in the repository, whose hash covers every default."""
    scene = load_scene(ROOT / "config" / "scenes" / "simulated_hand.yaml")
    card = load_model("simulated").card
    assert card["data"]["scene_sha256"] == scene.sha256()
    assert set(card["data"]["objects"]) == {object_.name for object_ in scene.objects}


@pytest.mark.slow
def test_readings_of_the_demo_are_in_the_intervals_as_often_as_stated(rng) -> None:
    model = load_model("simulated")
    runs = [demo_run(model, int(seed)) for seed in rng.integers(2**31, size=12)]
    for row in demo_rows(runs):
        beyond = 3.0 * row["standard_error"]  # of the mean over these runs
        assert row["unfamiliar"] == 1.0 if row["object"] == "figure" else row["unfamiliar"] <= 0.2, row
        assert 0.8 - beyond <= row["inside"] <= 0.99 + beyond, row


def test_committed_figures_of_the_demo_are_within_their_bounds() -> None:
    rows = read_csv(ROOT / "benchmarks" / "demo" / "demo.csv")
    assert [(row["object"], row["touches"], row["runs"]) for row in rows] == [
        (name, str(touches), "20") for name in ("can", "figure") for touches in range(5)
    ]
    assert all(0.8 <= float(row["inside"]) <= 0.99 for row in rows)
    rows = [row for row in read_csv(ROOT / "benchmarks" / "demo" / "ceiling.csv") if row["share"]]
    assert all(float(row["share"]) >= 0.8 for row in rows if row["name"] == "simulated, with a tare")


def test_objects_of_sizes_far_from_those_of_training_are_flagged_and_get_the_mean(can, make_grasps) -> None:
    for name in available_models():
        model = load_model(name)
        generalises = model.simulated  # its kernel predicts other objects, too
        for factor in (0.4, 2.5):
            cloud = scaled(can, factor)
            centre = cloud.xyz.mean(axis=0, dtype=np.float64)
            grasps = [
                Grasp(*(centre + factor * (p - centre) for p in (grasp.g1, grasp.g2)), grasp.rotation)
                for grasp in make_grasps(3)
            ]
            predictions = model.predict(cloud, grasps)
            assert all("unfamiliar" in p.flags for p in predictions), (name, factor)
            assert generalises or np.ptp([p.value.values for p in predictions], axis=0).max() < 1.0


@pytest.mark.real_data
def test_it_predicts_its_training_data(real_data: Path) -> None:
    model = load_model()
    samples = read_folder(real_data / "vision2tactile")[::5]
    predictions = [model.predict(sample.cloud, [sample.grasp])[0] for sample in samples]
    assert np.mean(["unfamiliar" in prediction.flags for prediction in predictions]) < 0.1
    predicted = np.array([p.value.values for p in predictions])
    actual = np.array([sample.touch.values for sample in samples])
    skill = 1.0 - ((predicted - actual) ** 2).mean(axis=0) / actual.var(axis=0)
    for modality in MODALITIES:
        assert skill[BIOTAC.columns([modality])].mean() > 0.1, modality
    assert folder_sha256(real_data / "vision2tactile") == model.card["data"]["sha256"]
    other = model.predict(samples[0].cloud, [samples[1].grasp])[0]
    assert not np.array_equal(other.value.values, predicted[0])  # it looks at the grasp
