# SPDX-License-Identifier: Apache-2.0
"""P2's Fig. 3 on the simulated deformables: does an SR-GAN need fewer labels than a PointNet?

Of 3200 training samples 10, 30, 50, 70 or 90 % lose their labels (T10...T90). The SR-GAN is trained on all of them and
on fake clouds, the PointNet on the labelled ones; both are tested on the same 800 samples, in several runs, with one
network per modality. The mean of the remaining labels, and trees on the geometry of the grasps with these labels, are
the baselines. `training` describes how both are trained, `results` how they are compared.

The preset `label_ratio_tuning` has as many trials for the PointNet as for the SR-GAN, and chooses without the test
samples: at a ratio, a quarter of the samples *that kept their labels* is held out, each network is trained on the other
three quarters, and the trial with the lowest error on the held-out samples is chosen, one for each model, ratio and kind
of modality. Neither test samples nor labels that the ratio withholds are used.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

from foretouch.config import Settings, setting
from foretouch.errors import ConfigError
from foretouch.models.network.config import ModelConfig
from foretouch.tactile import BIOTAC, MODALITIES
from foretouch_lab.experiments.framework.experiment import Cell, Experiment, Row
from foretouch_lab.experiments.label_ratio import results
from foretouch_lab.experiments.label_ratio.training import (
    MODELS,
    READINGS,
    SRGAN,
    TRIALS,
    UNTUNED,
    configured,
    error_row,
    kind_of,
    load_scene,
    prepared,
    split_at,
    train_and_predict,
)
from foretouch_lab.experiments.shared.simulated_data import SimulatedGrasps, SimulatedSettings, prepare_simulated
from foretouch_lab.learning.data import labels_of
from foretouch_lab.learning.data.splits import RATIOS
from foretouch_lab.learning.evaluation.baselines import geometry_trees
from foretouch_lab.learning.training.srgan import SrganConfig

__all__ = ["EXPERIMENTS"]


@dataclass(frozen=True, kw_only=True)
class ChosenTrials(Settings):
    """Trials of one model that `label_ratio_tuning` chose at T50 and, for fewer labels, at T90."""

    pressure: str = setting("", "Trial for PDC_TH and PDC_MF up to T50")
    electrodes: str = setting("", "Trial for E_TH and E_MF up to T50")
    pressure_few: str = setting("", "Trial for PDC_TH and PDC_MF above T50")
    electrodes_few: str = setting("", "Trial for E_TH and E_MF above T50")

    @classmethod
    def same(cls, trial: str) -> "ChosenTrials":
        """One trial for all."""
        return cls(pressure=trial, electrodes=trial, pressure_few=trial, electrodes_few=trial)


@dataclass(frozen=True, kw_only=True)
class LabelRatioSettings(SimulatedSettings):
    """Settings of `label_ratio` and `label_ratio_tuning`; the defaults are P2's sizes and recipe."""

    scene_sha256: str | None = setting(
        "78fe2fae95d57cf214ec8a4e6fdfd9d20d37391ab4c0da783bbb2dd1ec93a50e",
        "Hash of the required scene, config/scenes/deformables_wide.yaml; null accepts any scene",
    )
    cached_points: int = setting(
        2048,
        "Points of each cloud that are kept in memory, drawn once; training draws from these each time. At least as many as the network takes",
        minimum=32,
    )
    modalities: tuple[str, ...] = setting(MODALITIES, "Modalities; one network each", choices=MODALITIES)
    ratios: tuple[int, ...] = setting(RATIOS, "Percentages of the training samples without labels", choices=RATIOS)
    seeds: tuple[int, ...] = setting((0, 1, 2, 3, 4), "Seeds of the runs: five in P2", minimum=0)
    held_out: float = setting(
        0.0,
        "Share of the labelled samples that all trials are tested on; 0 tests the chosen trials on the test samples",
        bounds=(0.0, 0.5),
    )
    updates: int | None = setting(
        None, "Updates of each network at every ratio; by default from training.epochs", bounds=(1, 10_000_000)
    )
    readings: tuple[str, ...] = setting(
        (), "Trials of the SR-GAN that are compared with the PointNet beside the chosen one"
    )
    draws: int = setting(10_000, "Number of bootstrap samples for the intervals", bounds=(100, 1_000_000))
    model: ModelConfig = ModelConfig(channels="xyz+normals")
    training: SrganConfig = SrganConfig()
    pointnet: ChosenTrials = ChosenTrials.same("batch 0.001").replace(electrodes_few="frozen 0.001")
    srgan: ChosenTrials = ChosenTrials.same("batch_means w_U 0.1 w_F 0.01, batch 0.001")

    def __post_init__(self) -> None:
        super().__post_init__()
        taken = max(self.model.n_points, self.training.points or 0)
        if self.cached_points < taken:
            raise ConfigError(f"cached_points: {self.cached_points} points are fewer than the network's {taken}")

    def chosen(self, model: str, ratio: int, modality: str) -> str:
        """The trial that was chosen for a network."""
        return str(getattr(getattr(self, model), kind_of(modality) + "_few" * (ratio > 50)))


def _cells(settings: LabelRatioSettings, _data: SimulatedGrasps) -> list[Cell]:
    """The trees, then run by run the chosen trials and after them the readings, so that an interrupted sweep covers the figure."""
    chosen = [
        {"ratio": ratio, "modality": modality, "model": model, "seed": seed, "trial": trial}
        for seed in settings.seeds
        for ratio in settings.ratios
        for modality in settings.modalities
        for model in MODELS
        for trial in (TRIALS[model] if settings.held_out else [settings.chosen(model, ratio, modality)])
    ]
    pairs = [one for one in chosen if one["model"] == SRGAN]
    readings = [{**one, "trial": trial} for one in pairs for trial in settings.readings]
    ratios = () if settings.held_out else settings.ratios
    trees = [{"ratio": ratio, "model": results.TREES, "seed": 0} for ratio in ratios]
    return list({cell.key: cell for cell in (Cell(_key(one), one) for one in trees + chosen + readings)}.values())


def _key(values: Row) -> str:
    if values["model"] == results.TREES:
        return f"T{values['ratio']}+{results.TREES}"
    known = list({**TRIALS[values["model"]], **UNTUNED[values["model"]]})
    number = known.index(values["trial"]) if values["trial"] in known else ""
    return f"T{values['ratio']}+{values['modality']}+{values['model']}{number}+{values['seed']}"


def _run(cell: Cell, settings: LabelRatioSettings, data: SimulatedGrasps) -> list[Row]:
    """Train and test one network, or the trees."""
    ratio, model, seed = (cell.values[key] for key in ("ratio", "model", "seed"))
    split = split_at(data.collection, ratio, settings.held_out, seed)
    if model == results.TREES:
        # For all modalities at once, also those that are not asked for: a run may be extended by further ones.
        train, test = ([data.collection.samples[k] for k in index] for index in (split.train, split.test))
        found = geometry_trees(train, labels_of(train), test, seed)
        return [
            {"modality": name, **error_row(data.collection, (name,), split, found[:, BIOTAC.columns([name])])}
            for name in MODALITIES
        ]
    inputs = prepared(data, settings.model.replace(outputs=(cell.values["modality"],)), settings.cached_points)
    config = configured(settings.training, model, cell.values["trial"], len(split.train), settings.updates, seed)
    predicted, updates = train_and_predict(inputs, split, model, config)
    return [{"updates": updates, **error_row(data.collection, inputs.config.outputs, split, predicted)}]


def _tabulate(settings: LabelRatioSettings, rows: Sequence[Row]) -> list[Row]:
    if settings.held_out:
        return results.compare_trials(rows, len(settings.seeds), settings.modalities)
    return [
        {"srgan": name, **found}
        for name in (results.CHOSEN, *settings.readings)
        for found in results.compare_models(
            _rows_of(settings, rows, name), settings.model.ranges.ranges, settings.draws
        )
    ]


def _rows_of(settings: LabelRatioSettings, rows: Sequence[Row], name: str) -> list[Row]:
    """Rows of trees and PointNet, and those of the SR-GAN that are of the trial `name`."""
    return [
        row
        for row in rows
        if row["model"] != SRGAN
        or row["trial"] == (settings.chosen(SRGAN, row["ratio"], row["modality"]) if name == results.CHOSEN else name)
    ]


# The trials are changes of this recipe. `bfloat16` is that of the search for winning points alone.
_RECIPE: Final = {"optimiser": "adamw", "precision": "bfloat16"}

# P2's network and batches of its SR-GAN on all 750 points.
_PAPER: Final[dict[str, Any]] = {"training": _RECIPE, "updates": 300}

# 256 of 750 points, from real and from fake clouds.
_QUICK: Final[dict[str, Any]] = {
    **_PAPER,
    "cached_points": 1024,
    "model": {"n_points": 256, "channels": "xyz+normals"},
    "training": {**_RECIPE, "generator": {"noise_length": 4, "stride": 4}},
}

# A network of 64 features on 64 points, for tests.
_SMOKE: Final[dict[str, Any]] = {
    **_QUICK,
    "scene_sha256": None,
    "updates": 40,
    "model": {"n_points": 64, "channels": "xyz+normals", "tnet": False, "trunk_widths": [32, 64], "head_widths": [64]},
    "training": {**_RECIPE, "batch_size": 16, "generator": {"noise_length": 1, "widths": [16], "stride": 8}},
}

# Seeds of networks and held-out samples are not those of the runs.
_TUNING: Final = {"ratios": [50, 90], "held_out": 0.25, "seeds": [100], "modalities": ["PDC_MF", "E_TH"]}

# Three runs, in each reading of P2's losses.
_RUNS: Final[dict[str, Any]] = {"seeds": [0, 1, 2], "readings": READINGS}

_SHARED: Final[dict[str, Any]] = {
    "module": __name__,
    "settings": LabelRatioSettings,
    "load": load_scene,
    "cells": _cells,
    "run": _run,
    "tabulate": _tabulate,
    "prepare": prepare_simulated,
    "resumable_settings": ("modalities", "ratios", "seeds", "draws", "readings", *MODELS),
}

EXPERIMENTS: Final = (
    Experiment(
        name="label_ratio",
        question="Does an SR-GAN need fewer labels than a PointNet of the same size that is trained alike?",
        order=110,
        presets={
            "quick": {**_QUICK, **_RUNS, "ratios": [10, 50, 90]},
            "paper": {**_PAPER, **_RUNS, "ratios": [90]},
            "p2_as_printed": {
                "pointnet": ChosenTrials.same("P2").to_mapping(),
                "srgan": ChosenTrials.same("P2, as_printed").to_mapping(),
                "readings": ["P2, contrast", "P2, batch_means", "P2, srgan"],
            },
            "smoke": {**_SMOKE, **_RUNS, "samples": 200, "ratios": [50, 90], "seeds": [0, 1], "draws": 500},
        },
        summarise=results.summarise_models,
        figure=results.draw_models,
        **_SHARED,
    ),
    Experiment(
        name="label_ratio_tuning",
        question="Which of an equal number of trials per model has the lowest error on held-out training samples?",
        order=120,
        presets={
            "quick": {**_QUICK, **_TUNING},
            "paper": {**_PAPER, **_TUNING},
            "smoke": {**_SMOKE, **_TUNING, "samples": 400, "ratios": [50]},
        },
        summarise=results.summarise_trials,
        **_SHARED,
    ),
)
