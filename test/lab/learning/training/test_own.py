# SPDX-License-Identifier: Apache-2.0
"""Own predictors, calibrated and scored: held-out errors, and never those on what was learned by heart."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from experiment_samples import make_samples
from own_predictors import Bad, Constant, Familiar, Memory

import foretouch as ft
from foretouch.errors import ConfigError, DatasetError, ModelError
from foretouch.types import NO_GRASP
from foretouch_lab.learning.evaluation.baselines import BASELINES
from foretouch_lab.learning.training.scoring import evaluate

SAMPLES = make_samples(8, 5)
FEW = {name: BASELINES[name] for name in ("training_mean", "object_mean")}


@pytest.fixture(scope="module")
def memory() -> ft.TouchModel:
    return ft.calibrate(Memory(), SAMPLES)


def test_intervals_cover_nine_in_ten_readings_of_the_same_kind() -> None:
    model = ft.calibrate(Constant(), SAMPLES)
    others = make_samples(8, 5, seed=1)
    rows = [(model.predict(sample.cloud, [sample.grasp]), sample.touch.values) for sample in others]
    inside = np.mean([(p.lower.ravel() <= read) & (read <= p.upper.ravel()) for p, read in rows])
    assert 0.85 < inside < 0.99
    assert any("Whether it was trained on these samples is not known" in line for line in model.card["limits"])
    assert "sample_hashes" not in model.card["data"]


def test_a_predictor_that_can_be_fitted_gets_the_errors_on_grasps_that_it_was_not_fitted_to(memory) -> None:
    sample = SAMPLES[7]
    refitted = memory.predict(sample.cloud, [sample.grasp])
    assert np.allclose(refitted.value.ravel(), sample.touch.values)  # the final predictor knows all samples
    labels = np.array([one.touch.values for one in SAMPLES])
    assert ((refitted.upper - refitted.value).ravel() > labels.std(axis=0)).mean() > 0.9
    known_by_heart = Memory()
    known_by_heart.fit(SAMPLES)
    with pytest.raises(
        ModelError, match=r"Memory: no calibration can be made of its errors: .*; was it trained on them\?"
    ):
        ft.calibrate(known_by_heart, SAMPLES, refit=False)


def test_held_out_scores_of_what_knows_by_heart_are_those_of_the_mean(memory) -> None:
    scored = evaluate({"memory": memory, "given": Constant}, SAMPLES, splits=("object",), baselines=FEW)
    table = scored.scores["object"]
    assert list(table)[:3] == ["memory", "given", "training_mean"]
    assert {name: row["skill"] for name, row in table["memory"].items()} == pytest.approx(
        dict.fromkeys(table["memory"], 0.0)
    )
    assert table["memory"]["E_TH"]["coverage90"] == table["training_mean"]["E_TH"]["coverage90"]
    assert "fitted again" in scored.notes[0]
    assert "whether it was trained on these samples is not known" in scored.notes[1]
    assert "object  memory" in str(scored)
    assert scored.errors["object"]["memory"].counts.sum() == len(SAMPLES)


def test_intervals_of_familiar_grasps_are_of_other_times_and_of_others_of_objects_left_out() -> None:
    model = ft.calibrate(Familiar(), SAMPLES)
    sample = SAMPLES[0]
    thin = ft.Cloud(sample.cloud.xyz * np.float32([1.0, 0.2, 1.0]))
    half = []
    for cloud, group in ((sample.cloud, "known"), (thin, "new")):
        row = model.predict(cloud, [sample.grasp])
        half.append((row.upper - row.value).ravel())
        assert half[-1] == pytest.approx(model.calibration.unread_half_widths[group])
    assert not np.allclose(*half)


def test_an_own_model_adapts_to_readings_and_is_read_again(memory, tmp_path) -> None:
    card = memory.save(tmp_path / "mine")
    assert card.name == "Memory.json"
    again = ft.load_model(tmp_path / "mine", "own_predictors:Memory")
    sample, other = SAMPLES[0], SAMPLES[1]
    hand = ft.History(again)
    before = hand.predict(other.cloud, [other.grasp], stamp_ns=sample.stamp_ns)
    read = ft.Touch(sample.touch.values - 30.0, sample.touch.channels)
    hand.touched(sample.cloud, sample.grasp, read, stamp_ns=sample.stamp_ns)
    after = hand.predict(other.cloud, [other.grasp], stamp_ns=sample.stamp_ns + 1, same_object=True)
    assert after[0].reference == "touches"
    assert (after.value - before.value).mean() < -10.0
    hand.save(tmp_path / "history")
    assert ft.History.load(tmp_path / "history", memory).touches == 1


def test_what_cannot_be_calibrated_is_refused_in_one_line() -> None:
    bad = Bad()
    for fault, message in (
        ("nan", "campbells/0: .*not finite"),
        ("error", "estimate: ZeroDivisionError"),
        ("shape", "shape"),
    ):
        bad.fault = fault
        with pytest.raises(ModelError, match=message):
            ft.calibrate(bad, SAMPLES)
    with pytest.raises(ConfigError, match="split: 'objects' is not one of random, time, object"):
        ft.calibrate(Constant, SAMPLES, split="objects")
    with pytest.raises(ModelError, match=r"refit: own_predictors:Constant has no fit\(samples\)"):
        ft.calibrate(Constant, SAMPLES, refit=True)
    with pytest.raises(DatasetError, match="all samples are of campbells"):
        ft.calibrate(Constant, SAMPLES[:5])


@pytest.mark.parametrize(
    ("splits", "message"),
    [
        (3, "splits: 3 is not a list of random, time, object, touches"),
        ("object", "splits: 'object' is not a list of random, time, object, touches"),
        ([], r"splits: \[\] is not a list of random"),
        (["objects"], "splits: 'objects' is not one of random, time, object, touches; did you mean object"),
    ],
)
def test_splits_that_do_not_exist_are_refused_in_one_line(splits, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        ft.evaluate(Constant, SAMPLES, splits=splits)


MILLIMETRES = [*SAMPLES[:9], replace(SAMPLES[9], cloud=ft.Cloud(1e3 * SAMPLES[9].cloud.xyz))]
ASTRAY = [
    replace(SAMPLES[0], grasp=replace(SAMPLES[0].grasp, g1=SAMPLES[0].grasp.g1 + 0.5, g2=SAMPLES[0].grasp.g2 + 0.5)),
    *SAMPLES[1:9],
]
FEWER = [replace(sample, grasp=NO_GRASP) for sample in SAMPLES]
WRONG: dict[str, tuple[Callable[[], object], str]] = {
    **{
        f"calibrate of {options}": (lambda options=options: ft.calibrate(Constant, SAMPLES, "random", **options), f"{next(iter(options))}: .* is not a whole number from")
        for options in ({"seed": -1}, {"seed": "x"}, {"seed": 1.5}, {"workers": 0}, {"workers": "all"}, {"workers": True})
    },
    "fit by no recipe": (lambda: ft.fit(SAMPLES, None), "recipe: None is neither a name"),
    "fit of two datasets": (lambda: ft.fit(SAMPLES, data="session"), "data: is given twice"),
    "fit of grasps that are not known": (lambda: ft.fit(FEWER, calibrate=False), "grasp: is not known"),
    **{
        f"{name} of samples in millimetres": (lambda call=call: call(MILLIMETRES), r"sample 9 \(.*\): cloud: xyz: .* is it in metres")
        for name, call in {
            "fit": ft.fit,
            "calibrate": lambda samples: ft.calibrate(Constant, samples, "random"),
            "evaluate": lambda samples: ft.evaluate(Constant, samples),
        }.items()
    },
    "fit of a grasp in another frame": (lambda: ft.fit(ASTRAY), r"sample 0 \(.*\): grasp: g1.*are both in metres and in one frame"),
    "fit with intervals of one object": (lambda: ft.fit(SAMPLES[:5], calibrate=True, contact={"trees": 2}), "calibrate: No calibration: "),
}  # fmt: skip


@pytest.mark.parametrize("name", WRONG)
def test_what_cannot_be_fitted_or_calibrated_is_named(name: str) -> None:
    call, message = WRONG[name]
    with pytest.raises(ft.ForetouchError, match=message):
        call()


def test_intervals_of_one_object_say_that_others_were_not_measured() -> None:
    model = ft.calibrate(Constant(), SAMPLES[:5], "random")
    assert model.calibration is not None
    assert "coverage of others was not measured" in model.card["limits"][0]


def test_a_predictor_is_scored_by_its_name() -> None:
    scored = evaluate("own_predictors:Constant", SAMPLES, splits=("random",), baselines=FEW)
    assert "own_predictors:Constant" in scored.notes[0]


def test_a_given_model_is_not_scored_on_what_it_was_trained_on_and_a_recipe_is_fitted_in_each_fold() -> None:
    settings = {"calibrate": False, "contact": {"trees": 2, "thinned": 1.0}}
    model = ft.fit(SAMPLES[:30], **settings)
    scored = evaluate(model, SAMPLES, splits=("random",), baselines=FEW)
    assert scored.samples == {"random": 10}
    assert "30 samples that it was trained on are left out" in scored.notes[0]
    with pytest.raises(
        DatasetError, match="all 30 samples were trained on by a model, so that none is held out; pass refit"
    ):
        evaluate(model, SAMPLES[:30])
    assert evaluate(model, SAMPLES[:30], splits=("random",), refit=True, baselines=FEW).samples == {"random": 30}
