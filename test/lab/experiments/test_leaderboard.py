# SPDX-License-Identifier: Apache-2.0
"""The leaderboard: its rows follow from the held-out predictions, and each row can be added by itself."""

import hashlib
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from experiment_samples import cell_rows, make_collection
from own_predictors import Memory

from foretouch import fit
from foretouch.errors import ConfigError
from foretouch.tactile import MODALITIES
from foretouch.types import Cloud
from foretouch_lab.experiments import find_experiment
from foretouch_lab.experiments.framework.experiment import Row
from foretouch_lab.experiments.framework.manifest import read_results
from foretouch_lab.experiments.leaderboard import LeaderboardSettings
from foretouch_lab.experiments.shared.tables import select
from foretouch_lab.learning.data import Dataset, labels_of, load_dataset, make_folds
from foretouch_lab.learning.data.folds import Fold
from foretouch_lab.learning.evaluation.baselines import object_mean, training_mean
from foretouch_lab.learning.evaluation.metrics import MEAN, mean_skill
from foretouch_lab.learning.training.scoring import evaluate, hold_out

QUICK = {"baselines": ["training_mean", "object_mean", "clock"], "bootstrap.draws": 200}
MINE = "own_predictors:Memory"
RESULTS = Path(__file__).parents[3] / "docs/results/leaderboard/results.csv"
FROZEN = {
    ("random", 5): "ea0a330fda25b70bdcc53c8a60fa26062f06e171a1b49d86af5760f61a6ed155",
    ("time", 1): "a94a850388b9154d9f2b6392d1badee9d80042c5bdc08d8aadff3d9aff9e9d24",
    ("object", 1): "fc1e00fd6b4cbb249a8ec497941418502788102aa91c6e01ae528cbc62687cdb",
}
"""Folds by split and number of seeds; fixed before any model of our own was tuned, and not to be renewed."""


@pytest.fixture(scope="module")
def data() -> Dataset:
    return make_collection()


@pytest.fixture(scope="module")
def table(data: Dataset, tmp_path_factory) -> list[Row]:
    return scored(data, tmp_path_factory.mktemp("sweep"), models=[MINE], splits=["random", "object", "touches"])


def scored(data: Dataset, folder: Path, **changes: Any) -> list[Row]:
    """Rows of the table, from cells that ran in this process."""
    rows, settings = cell_rows("leaderboard", data, **{**QUICK, **changes})
    return find_experiment("leaderboard").finish(settings, data, rows, folder, lambda *_: None)


@pytest.fixture(scope="module")
def real(real_data) -> Dataset:
    data = load_dataset(real_data / "vision2tactile")
    if len(data.samples) != 400:
        pytest.skip("other objects are there than those of the committed results")
    return data


@pytest.mark.real_data
def test_folds_are_frozen(real: Dataset) -> None:
    def digest(split: str, seeds: int) -> str:
        folds = [
            [[real.samples[k].id for k in side] for side in (fold.train, fold.test)]
            for seed in range(seeds)
            for fold in make_folds(real.samples, split, seed)
        ]
        return hashlib.sha256(json.dumps(folds).encode()).hexdigest()

    assert {key: digest(*key) for key in FROZEN} == FROZEN


@pytest.mark.real_data
def test_committed_scores_come_out_again(real: Dataset, tmp_path) -> None:
    """Of predictors that are means, which do not depend on the order of sums."""
    means = ["training_mean", "object_mean"]
    table = scored(real, tmp_path, baselines=means, models=[], splits=["random", "time", "object"])
    committed = read_results(RESULTS)
    for row in table:
        place = {key: row[key] for key in ("split", "predictor", "modality", "samples", "objects")}
        (kept,) = select(committed, **place)
        found, wanted = ({k: one[k] for k in ("rmse", "skill") if one[k] is not None} for one in (row, kept))
        assert found == pytest.approx(wanted, rel=1e-4, abs=2e-3)


def test_an_own_predictor_is_refitted_in_each_fold_and_stands_beside_every_baseline(
    table: list[Row], data: Dataset
) -> None:
    assert {row["predictor"] for row in table} == {*QUICK["baselines"], MINE}
    mine = select(table, predictor=MINE)
    assert {row["note"] for row in mine} == {f"{MINE}, fitted again without the samples of each fold"}
    labels = labels_of(data.samples)
    for split in ("random", "object"):
        own, mean = (select(table, split=split, predictor=name) for name in (MINE, "training_mean"))
        for row, other in zip(own, mean, strict=True):  # it predicts the mean of what it was fitted to
            assert row["skill"] == pytest.approx(0.0, abs=1e-9)
            assert row["rmse"] == other["rmse"]
        folds = make_folds(data.samples, split, 0)
        residuals = np.concatenate([labels[fold.test] - labels[fold.train].mean(axis=0) for fold in folds])
        errors = {row["modality"]: row["rmse"] for row in own}
        assert errors["PDC_TH"] == pytest.approx(np.sqrt((residuals[:, 0] ** 2).mean()))
        assert errors["E_MF"] == pytest.approx(np.sqrt((residuals[:, 26:] ** 2).mean()))


def test_scores_are_shown_in_a_few_lines_and_printed_as_a_table(data: Dataset) -> None:
    means = {"training_mean": training_mean, "object_mean": object_mean}
    result = evaluate({"mine": Memory()}, data.samples, ["random", "touches"], baselines=means)
    best = max(means | {"mine": 0}, key=lambda name: mean_skill(result.scores["random"][name]))
    assert repr(result).splitlines()[0].startswith("Evaluation(mean skill on samples)")
    assert f"best of 3: {best} " in repr(result)
    assert len(repr(result).splitlines()) == 3
    assert len([line for line in str(result).splitlines() if line.startswith(("random", "touches"))]) == 6


def test_a_significant_difference_is_paired_with_the_best_baseline(table: list[Row]) -> None:
    for split in ("random", "object", "touches"):
        total = select(table, split=split, modality=MEAN)
        best = max((row for row in total if row["predictor"] != MINE), key=lambda row: row["skill"])
        for row in total:
            assert row["best_baseline"] == best["predictor"]
            if row["predictor"] == best["predictor"]:
                assert row["vs_best"] is None
            else:
                assert row["vs_best"] == pytest.approx(row["skill"] - best["skill"])
                inside = row["vs_best_low"] <= 0.0 <= row["vs_best_high"]
                assert inside == (row["vs_best_verdict"] == "tie")
    assert select(table, split="random", predictor=MINE, modality=MEAN)[0]["vs_best_verdict"] == "worse"


def test_the_first_touches_of_an_object_are_few_and_help(table: list[Row], data: Dataset) -> None:
    objects = len({sample.object for sample in data.samples})
    touches = select(table, split="touches", predictor=MINE)
    assert {(row["samples"], row["objects"]) for row in touches} == {(3 * objects, objects)}
    by_modality = {row["modality"]: row["skill"] for row in touches}
    assert by_modality["E_TH"] > 0.05  # whose values differ between objects
    for row in table:
        if row["modality"] in MODALITIES:
            assert 0.5 < row["coverage90"] <= 1.0
            assert row["interval_score"] > 0.0


def test_tables_and_picture_show_all_rows(table: list[Row], tmp_path) -> None:
    experiment = find_experiment("leaderboard")
    tables = experiment.tables(table)
    assert [one.title.partition(":")[0] for one in tables] == ["random", "object", "touches"]
    assert all(len(one.rows) == 4 for one in tables)
    assert any(note.startswith(f"{MINE}: ") for note in tables[-1].notes)
    (picture,) = experiment.draw(table, tmp_path)
    assert picture.stat().st_size > 10_000


def test_a_model_folder_is_used_as_it_is_and_its_training_grasps_are_left_out(data: Dataset, tmp_path) -> None:
    seen = [sample for sample in data.samples if sample.object != "wood"]
    folder = tmp_path / "mine"
    fit(seen, "contact-v3", calibrate=False, contact={"trees": 3}).save(folder)
    table = scored(data, tmp_path, models=[str(folder)], splits=["random"])
    (total,) = select(table, predictor=str(folder), modality=MEAN)
    assert (total["samples"], total["objects"], len(total["hash"])) == (12, 1, 16)
    assert "given as it is; 84 samples that it was trained on are left out" in total["note"]
    assert total["vs_best"] is None  # it was not scored on the same grasps


def test_a_row_is_made_of_folds_and_one_that_lacks_a_fold_is_left_out(data: Dataset, tmp_path) -> None:
    rows, settings = cell_rows("leaderboard", data, **QUICK, models=[], splits=["random", "object"], seeds=[0, 3])
    experiment = find_experiment("leaderboard")
    assert len({row["key"] for row in rows}) == len(rows) == 2 * 3 * (5 + 8)
    lost = next(row["key"] for row in rows if (row["predictor"], row["split"]) == ("clock", "object"))
    kept = [row for row in rows if row["key"] != lost]
    table = experiment.finish(settings, data, kept, tmp_path, lambda *_: None)
    names = {split: {row["predictor"] for row in select(table, split=split)} for split in ("random", "object")}
    assert names["random"] - names["object"] == {"clock"}
    every = experiment.finish(settings, data, rows, tmp_path, lambda *_: None)
    assert select(every, split="random") == select(table, split="random")
    assert {row["seeds"] for row in every} == {"0 3"}


def test_a_recipe_is_a_row_with_its_settings(data: Dataset, tmp_path) -> None:
    plain, changed = "contact-v3 contact.trees=3", "contact-v3 contact.trees=4"
    table = scored(data, tmp_path, models=[plain, changed], splits=["random"])
    by_name = {name: select(table, predictor=name, modality=MEAN)[0] for name in (plain, changed)}
    assert by_name[plain]["hash"] != by_name[changed]["hash"]
    direct = evaluate({"m": plain}, data.samples, ["random"], baselines={})
    assert mean_skill(direct.scores["random"]["m"]) == pytest.approx(by_name[plain]["skill"])
    assert direct.notes == (f"m: recipe {plain}, fitted again without the samples of each fold",)


@pytest.mark.slow
def test_the_sr_gan_learns_nothing_from_the_clouds_of_the_fold_that_it_is_tested_on() -> None:
    data = make_collection(3, 8)
    widths = "model.trunk_widths=[8,16] model.tnet_widths=[8,8,16,8,8] model.head_widths=[16]"
    small = f"model.channels=xyz model.n_points=16 {widths} srgan.epochs=1"
    words = f"p2_srgan model.outputs=[PDC_TH,PDC_MF,E_TH,E_MF] {small}"
    fold = make_folds(data.samples, "object", 0)[0]
    other = [replace(one, cloud=Cloud(one.cloud.xyz * np.float32([1.0, 2.0, 1.0]))) for one in data.samples]
    moved = [other[k] if k in fold.test else one for k, one in enumerate(data.samples)]
    asked = Fold(fold.train, np.arange(len(data.samples)))
    plain, unseen, seen = (
        hold_out(words, replace(data, samples=tuple(samples))).predict(asked)[fold.train]
        for samples in (data.samples, moved, other)
    )
    assert np.isfinite(plain).all()
    assert np.array_equal(plain, unseen)  # whatever the clouds of the test side are
    assert not np.array_equal(plain, seen)


def test_what_cannot_be_a_row_is_refused(data: Dataset) -> None:
    with pytest.raises(ConfigError, match="models: clock is a baseline"):
        LeaderboardSettings(models=("clock",))
    with pytest.raises(ConfigError, match="models: contact-v3 is given twice"):
        LeaderboardSettings(models=("contact-v3", "contact-v3"))
    with pytest.raises(ConfigError, match=r"models: contact-v4: .*did you mean contact-v3\?; nor is it a model folder"):
        cell_rows("leaderboard", data, baselines=[], models=["contact-v4"], splits=["random"])
