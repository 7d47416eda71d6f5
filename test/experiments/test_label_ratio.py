# SPDX-License-Identifier: Apache-2.0
"""P2's label ratios, on a few simulated grasps and with networks that are hardly trained."""

import shutil
from pathlib import Path
from typing import Any

import pytest

from foretouch.errors import ConfigError, DatasetError, FileError
from foretouch.experiments import Cell, find_experiment, run_sweep
from foretouch.experiments.framework.manifest import RESULTS_FILE, read_results
from foretouch.experiments.label_ratio.data import RatioDataSettings, load_frozen, split_at
from foretouch.experiments.label_ratio.training import MODELS, TRIALS, configured
from foretouch.experiments.shared.simulated_data import SimulatedGrasps, simulate_store
from foretouch.learning.data.splits import RATIOS

ROOT = Path(__file__).parents[2]
SCENE = ROOT / "config" / "scenes" / "deformables.yaml"
TINY: dict[str, Any] = {
    "updates": 8,
    "ratios": [50, 90],
    "seeds": [0, 1],
    "modalities": ["PDC_TH"],
    "stock": 64,
    "training.batch_size": 4,
}

PRINTED = {"pointnet": "P2", "srgan": "P2, as_printed"}


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return simulate_store(SCENE, 80, tmp_path_factory.mktemp("deformables"))


@pytest.fixture(scope="module")
def data(store: Path) -> SimulatedGrasps:
    return load_frozen(RatioDataSettings(), store)


def test_the_scene_is_the_frozen_one(store: Path) -> None:
    assert RatioDataSettings().scene_sha256 == SCENE.with_suffix(".sha256").read_text().strip()
    with pytest.raises(DatasetError, match="is not abc, the frozen scene's"):
        load_frozen(RatioDataSettings(scene_sha256="abc"), store)


@pytest.mark.parametrize("ratio", RATIOS)
def test_no_test_sample_is_trained_on_or_chosen_by(data: SimulatedGrasps, ratio: int) -> None:
    final, tuned = split_at(data.collection, ratio), split_at(data.collection, ratio, held_out=0.25, seed=3)
    test = set(final.test.tolist())
    assert len(test) == 16
    for index in (final.train, final.unlabelled, tuned.train, tuned.unlabelled, tuned.test):
        assert test.isdisjoint(index.tolist())
    # Only labels that the ratio leaves are held out, and those are not trained on.
    assert sorted([*tuned.train, *tuned.test]) == sorted(final.train)
    assert len(final.unlabelled) == round(64 * ratio / 100)


def test_an_empty_held_out_set_is_refused(data: SimulatedGrasps) -> None:
    with pytest.raises(DatasetError, match=r"held: 0.01 of 6 samples is none"):
        split_at(data.collection, 90, held_out=0.01)


def test_both_models_take_as_many_updates_in_every_cell(data: SimulatedGrasps) -> None:
    experiment = find_experiment("label_ratio")
    settings = experiment.resolve("smoke", TINY)
    cells = [cell for cell in experiment.cells(settings, data) if cell.values["model"] in MODELS]
    assert len(cells) == 2 * 2 * 2
    first: dict[tuple[Any, ...], list[Cell]] = {}
    for cell in cells:
        first.setdefault((cell.values["ratio"], cell.values["seed"]), []).append(cell)
    for pair in [pair for (_, seed), pair in first.items() if seed == 0]:
        assert [cell.values["model"] for cell in pair] == list(MODELS)
        rows = [experiment.run(cell, settings, data)[0] for cell in pair]
        assert rows[0]["updates"] == rows[1]["updates"] == 8
        assert rows[0]["labelled"] == rows[1]["labelled"]
        references = [[one["reference"] for one in row["objects"].values()] for row in rows]
        assert references[0] == references[1]  # the same samples, in the same order
        assert rows[0]["objects"] != rows[1]["objects"]


@pytest.mark.parametrize("reading", ["", "_contrast", "_srgan"])
def test_the_printed_recipe_is_that_of_p2(data: SimulatedGrasps, reading: str) -> None:
    experiment = find_experiment("label_ratio")
    settings = experiment.resolve(f"p2_as_printed{reading}", {})
    cells = [cell for cell in experiment.cells(settings, data) if cell.values["model"] in MODELS]
    assert len(cells) == 5 * 5 * 4 * 2
    assert (settings.model.n_points, settings.model.feature_size, settings.model.head_size) == (750, 1024, 1039)
    found = {}
    for cell in cells:
        config = configured(settings.training, cell.values["model"], cell.values["trial"], 320, settings.updates, 0)
        found[cell.values["model"]] = config
        assert (config.optimiser, config.learning_rate, config.schedule) == ("adam", 0.01, "constant")
        assert (config.weight_decay, config.target_scaling) == (0.0, "ranges")
    assert (found["pointnet"].batch_size, found["pointnet"].epochs) == (32, 50)
    assert (found["srgan"].batch_size, found["srgan"].epochs) == (10, 30)
    loss = found["srgan"].loss
    assert loss.reading == (reading.removeprefix("_") or "as_printed")
    assert (loss.weight_labeled, loss.weight_unlabeled, loss.weight_fake, loss.gradient_penalty) == (
        1.0,
        10.0,
        0.1,
        0.0,
    )


def test_the_network_sees_as_many_different_points_as_it_takes() -> None:
    experiment = find_experiment("label_ratio")
    for name in experiment.presets:
        settings = experiment.resolve(name, {})
        assert settings.stock >= settings.model.n_points
    with pytest.raises(ConfigError, match=r"LabelRatioSettings\.stock: 512 points are fewer than the network's 750"):
        experiment.resolve("p2_as_printed", {"stock": 512})


def test_a_run_may_be_extended_but_not_by_other_trials(store: Path, tmp_path: Path) -> None:
    experiment = find_experiment("label_ratio")
    words = {"source": store, "resume": True}
    one = experiment.resolve("smoke", {**TINY, "seeds": [0], "ratios": [90], **_trials(1)})
    assert run_sweep(experiment, one, tmp_path / "out", **words).finished == 3
    more = run_sweep(experiment, experiment.resolve("smoke", {**TINY, "seeds": [0]}), tmp_path / "out", **words)
    assert (more.reused, more.finished) == (3, 6)
    both = experiment.resolve("smoke", {**TINY, "seeds": [0], "modalities": ["PDC_TH", "E_MF"]})
    rows = run_sweep(experiment, both, tmp_path / "out", **words).rows
    assert [(row["modality"], row["ratio"]) for row in rows] == [(m, r) for m in ("PDC_TH", "E_MF") for r in (50, 90)]
    assert all(row["trees_rmse"] is not None for row in rows)
    other = experiment.resolve("smoke", {**TINY, "seeds": [0], "pointnet.pressure": ["rate 0.003"] * 2})
    with pytest.raises(FileError, match=r"T50\+PDC_TH\+pointnet\+0\.json: was run with other values"):
        run_sweep(experiment, other, tmp_path / "out", **words)


def _trials(ratios: int) -> dict[str, Any]:
    chosen = find_experiment("label_ratio").presets["smoke"]
    return {f"{model}.{kind}": trials[-ratios:] for model in MODELS for kind, trials in chosen[model].items()}


def test_the_printed_recipe_runs(data: SimulatedGrasps) -> None:
    experiment = find_experiment("label_ratio")
    tiny = {"model.n_points": 32, "model.trunk_widths": [8, 16], "model.tnet": False, "model.head_widths": [8]}
    small = {"stock": 64, "modalities": ["PDC_TH"], "updates": 4, "ratios": [50], "seeds": [0], "training.points": 32}
    small |= {f"{model}.{kind}": [trial] for model, trial in PRINTED.items() for kind in ("pressure", "electrodes")}
    generator = {"training.generator": {"noise_length": 4, "widths": [4], "stride": 3}}
    settings = experiment.resolve("p2_as_printed", {**tiny, **small, **generator})
    for cell in experiment.cells(settings, data):
        if cell.values["model"] in MODELS:
            (row,) = experiment.run(cell, settings, data)
            assert row["updates"] in (4, 3)
            assert row["labelled"] == 32


def test_a_sweep_that_was_cut_gives_the_same_table(store: Path, tmp_path: Path) -> None:
    experiment = find_experiment("label_ratio")
    settings = experiment.resolve("smoke", TINY)
    whole, cut = tmp_path / "whole", tmp_path / "cut"
    result = run_sweep(experiment, settings, whole, source=store)
    assert result.failures == {}
    shutil.copytree(whole, cut)
    (cut / "results.csv").unlink()
    for cell in sorted((cut / "cells").iterdir())[::2]:
        cell.unlink()
    again = run_sweep(experiment, settings, cut, source=store, resume=True)
    assert (again.reused, again.cells) == (5, 10)
    assert (whole / "results.csv").read_bytes() == (cut / "results.csv").read_bytes()
    assert {row["runs"] for row in result.rows} == {2}
    assert [table.title for table in experiment.summarise(result.rows)][2] == "SR-GAN against PointNet [%]"
    assert all(0.0 < row["trees_rmse"] != row["mean_rmse"] for row in result.rows)


def test_tuning_gives_both_models_as_many_trials_and_chooses_one(store: Path, tmp_path: Path) -> None:
    experiment = find_experiment("label_ratio_tuning")
    settings = experiment.resolve("smoke", {name: TINY[name] for name in TINY if name not in ("ratios", "seeds")})
    assert len(TRIALS["pointnet"]) == len(TRIALS["srgan"])
    result = run_sweep(experiment, settings, tmp_path / "out", source=store)
    assert result.failures == {}
    for model in MODELS:
        mine = [row for row in result.rows if row["model"] == model]
        assert [row["trial"] for row in mine] == list(TRIALS[model])
        (chosen,) = [row for row in mine if row["chosen"]]
        assert chosen["relative_rmse"] == min(row["relative_rmse"] for row in mine)
        assert {(row["kind"], row["held"]) for row in mine} == {("pressure", 8)}
    assert experiment.summarise(result.rows)[0].title.startswith("T50, pressure")


@pytest.mark.parametrize("preset", ["paper", "quick"])
def test_the_presets_hold_what_tuning_chose(preset: str) -> None:
    """T90's choice serves T70 and T90, T50's the others."""
    rows = read_results(ROOT / "docs" / "results" / "label_ratio_tuning" / RESULTS_FILE)
    chosen = {(row["model"], row["kind"], row["ratio"]): row["trial"] for row in rows if row["chosen"]}
    settings = find_experiment("label_ratio").resolve(preset, {})
    for model in MODELS:
        for kind in ("pressure", "electrodes"):
            wanted = [chosen[model, kind, 90 if ratio >= 70 else 50] for ratio in settings.ratios]
            assert list(getattr(getattr(settings, model), kind)) == wanted


@pytest.mark.parametrize("name", ["label_ratio", "label_ratio_tuning"])
def test_the_trials_keep_the_recipe_they_were_chosen_with_at_the_size_of_p2(name: str) -> None:
    small, large = (find_experiment(name).resolve(preset, {}) for preset in ("quick", "paper"))
    for key in ("optimiser", "learning_rate", "weight_decay", "schedule", "target_scaling", "batch_norm", "loss"):
        assert getattr(large.training, key) == getattr(small.training, key)
    assert (large.training.optimiser, large.training.schedule) == ("adamw", "cosine")
    assert large.model.metric_inputs
    assert small.model.metric_inputs
    assert (large.model.n_points, large.model.feature_size, large.model.tnet) == (750, 1024, True)
    assert (large.training.batch_size, large.training.epochs) == (10, 30)


def test_a_trial_for_each_ratio_is_wanted() -> None:
    with pytest.raises(ConfigError, match=r"LabelRatioSettings.srgan.electrodes: 1 trials are not one for each of 5"):
        find_experiment("label_ratio").resolve("quick", {"srgan": {"electrodes": ["0.3/1/1"]}})


def test_an_unknown_trial_is_refused(data: SimulatedGrasps) -> None:
    experiment = find_experiment("label_ratio")
    settings = experiment.resolve("smoke", TINY | {"pointnet": {"pressure": ["fast", "faster"]}})
    with pytest.raises(ConfigError, match="pointnet 'fast' is none of rate"):
        experiment.run(experiment.cells(settings, data)[len(settings.ratios)], settings, data)
