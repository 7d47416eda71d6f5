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
from foretouch.experiments.framework.experiment import Cell, Experiment, Row
from foretouch.experiments.label_ratio import results
from foretouch.experiments.label_ratio.training import (
    AS_PRINTED,
    MODELS,
    TRIALS,
    configured,
    error_row,
    kind_of,
    load_scene,
    prepared,
    split_at,
    train_and_predict,
)
from foretouch.experiments.shared.simulated_data import SimulatedGrasps, SimulatedSettings, prepare_simulated
from foretouch.learning.data import labels_of
from foretouch.learning.data.splits import RATIOS
from foretouch.learning.evaluation.baselines import geometry_trees
from foretouch.learning.training.srgan import SrganConfig
from foretouch.models.network.config import ModelConfig
from foretouch.tactile import MODALITIES, columns

__all__ = ["EXPERIMENTS"]


@dataclass(frozen=True, kw_only=True)
class ChosenTrials(Settings):
    """Trials of one model at each ratio, as chosen by `label_ratio_tuning`."""

    pressure: tuple[str, ...] = setting((), "Trials for PDC_TH and PDC_MF")
    electrodes: tuple[str, ...] = setting((), "Trials for E_TH and E_MF")


@dataclass(frozen=True, kw_only=True)
class LabelRatioSettings(SimulatedSettings):
    """Settings of `label_ratio` and `label_ratio_tuning`; the defaults are P2's sizes and recipe."""

    scene_sha256: str | None = setting(
        "db79f5dd4379f4293d1bc390690fb94f61cba827eb42fd4f5fd58ce6e58f7c5b",
        "Hash of the required scene, config/scenes/deformables.sha256; null accepts any scene",
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
        minimum=0.0,
        maximum=0.5,
    )
    updates: int | None = setting(
        None, "Updates of each network at every ratio; by default from training.epochs", minimum=1, maximum=10_000_000
    )
    draws: int = setting(10_000, "Number of bootstrap samples for the intervals", minimum=100, maximum=1_000_000)
    model: ModelConfig = ModelConfig(channels="xyz+normals")
    training: SrganConfig = SrganConfig()
    pointnet: ChosenTrials = ChosenTrials()
    srgan: ChosenTrials = ChosenTrials()

    def __post_init__(self) -> None:
        super().__post_init__()
        taken = max(self.model.n_points, self.training.points or 0)
        if self.cached_points < taken:
            raise ConfigError(f"cached_points: {self.cached_points} points are fewer than the network's {taken}")
        for model in MODELS if self.held_out == 0.0 else ():
            for kind, trials in getattr(self, model).to_mapping().items():
                if len(trials) != len(self.ratios):
                    raise ConfigError(
                        f"{model}.{kind}: {len(trials)} trials are not one for each of {len(self.ratios)} ratios"
                    )

    def trials(self, model: str, ratio: int, modality: str) -> Sequence[str]:
        """Trials of a network: the chosen one, or all."""
        if self.held_out:
            return tuple(TRIALS[model])
        chosen: tuple[str, ...] = getattr(getattr(self, model), kind_of(modality))
        return (chosen[self.ratios.index(ratio)],)


def _cells(settings: LabelRatioSettings, _data: SimulatedGrasps) -> list[Cell]:
    """The trees, then run by run, so that an interrupted sweep covers the whole figure."""
    ratios = () if settings.held_out else settings.ratios
    trees = [Cell(f"T{one}+{results.TREES}", {"ratio": one, "model": results.TREES, "seed": 0}) for one in ratios]
    networks = [
        {"ratio": ratio, "modality": modality, "model": model, "seed": seed, "trial": trial}
        for seed in settings.seeds
        for ratio in settings.ratios
        for modality in settings.modalities
        for model in MODELS
        for trial in settings.trials(model, ratio, modality)
    ]
    return trees + [Cell(_key(values, settings), values) for values in networks]


def _key(values: Row, settings: LabelRatioSettings) -> str:
    number = f"+{list(TRIALS[values['model']]).index(values['trial'])}" if settings.held_out else ""
    return f"T{values['ratio']}+{values['modality']}+{values['model']}{number}+{values['seed']}"


def _run(cell: Cell, settings: LabelRatioSettings, data: SimulatedGrasps) -> list[Row]:
    """Train and test one network, or the trees."""
    ratio, model, seed = (cell.values[key] for key in ("ratio", "model", "seed"))
    split = split_at(data.collection, ratio, settings.held_out, seed)
    objects = [data.collection.samples[k].object for k in split.test]
    if model == results.TREES:
        # For all modalities at once, also those that are not asked for: a run may be extended by further ones.
        train, test = ([data.collection.samples[k] for k in index] for index in (split.train, split.test))
        found = geometry_trees(train, labels_of(train), test, seed)
        named = {
            name: prepared(data, settings.model.replace(outputs=(name,)), settings.cached_points) for name in MODALITIES
        }
        return [
            {"modality": name, **error_row(inputs, split, found[:, columns([name])], objects)}
            for name, inputs in named.items()
        ]
    trial = cell.values["trial"]
    inputs = prepared(data, settings.model.replace(outputs=(cell.values["modality"],)), settings.cached_points)
    config = configured(settings.training, model, trial, len(split.train), settings.updates, seed)
    predicted, updates = train_and_predict(inputs, split, model, config, as_printed=trial in AS_PRINTED[model])
    return [{"updates": updates, **error_row(inputs, split, predicted, objects)}]


def _tabulate(settings: LabelRatioSettings, rows: Sequence[Row]) -> list[Row]:
    if settings.held_out:
        return results.compare_trials(rows, len(settings.seeds), settings.modalities)
    return results.compare_models(rows, settings.model.ranges, settings.draws)


# The trials are changes of this recipe, so their rates and weight decays belong to it.
_RECIPE: Final = {"optimiser": "adamw", "learning_rate": 3e-3, "schedule": "cosine", "target_scaling": "standardised"}

# P2's sizes, epochs and batches of its SR-GAN, with the recipe of the trials and the size of the object as input.
_PAPER: Final[dict[str, Any]] = {"model": {"metric_inputs": True}, "training": _RECIPE}

# 64 of 750 points, features of 64 instead of 1024 values, no T-Net, a generator of 64 points.
_QUICK: Final[dict[str, Any]] = {
    "cached_points": 512,
    "updates": 960,
    "model": {
        "n_points": 64,
        "channels": "xyz+normals",
        "metric_inputs": True,
        "tnet": False,
        "trunk_widths": [32, 64],
        "head_widths": [64, 32],
    },
    "training": {**_RECIPE, "batch_size": 16, "generator": {"noise_length": 1, "widths": [16], "stride": 8}},
}

_SMOKE: Final[dict[str, Any]] = {**_QUICK, "updates": 40}

# Seeds of networks and held-out samples are not those of the runs.
_TUNING: Final = {"ratios": [50, 90], "held_out": 0.25, "seeds": [100]}


def _chosen(ratios: Sequence[int]) -> dict[str, dict[str, list[str]]]:
    """Trials chosen in docs/results/label_ratio_tuning; T90's are used at T70 too, T50's at T10 and T30."""
    tuned = {
        "pointnet": {
            "pressure": ("rate 0.001, decay 0.3", "rate 0.0003, decay 0.3"),
            "electrodes": ("rate 0.003", "rate 0.001, decay 1"),
        },
        "srgan": {"pressure": ("0.3/1/1", "0.3/1/1, rate 0.001, decay 0.3"), "electrodes": ("0.3/1/1", "0.3/1/0.3")},
    }
    return {
        model: {
            kind: [few_labels if ratio >= 70 else many_labels for ratio in ratios]
            for kind, (many_labels, few_labels) in kinds.items()
        }
        for model, kinds in tuned.items()
    }


def _as_printed(loss_variant: str) -> dict[str, dict[str, list[str]]]:
    """P2's recipe at every ratio, with one variant of its losses."""
    trials = {"pointnet": "P2", "srgan": f"P2, {loss_variant}"}
    return {
        model: {kind: [trial] * len(RATIOS) for kind in ("pressure", "electrodes")} for model, trial in trials.items()
    }


_SHARED: Final[dict[str, Any]] = {
    "module": __name__,
    "settings": LabelRatioSettings,
    "load": load_scene,
    "cells": _cells,
    "run": _run,
    "tabulate": _tabulate,
    "prepare": prepare_simulated,
    "resumable_settings": ("modalities", "ratios", "seeds", "draws", *MODELS),
}

EXPERIMENTS: Final = (
    Experiment(
        name="label_ratio",
        question="Does an SR-GAN need fewer labels than a PointNet of the same size that is trained alike?",
        order=110,
        presets={
            "paper": {**_PAPER, **_chosen(RATIOS)},
            "p2_as_printed": _as_printed("as_printed"),
            "p2_as_printed_contrast": _as_printed("contrast"),
            "p2_as_printed_batch_means": _as_printed("batch_means"),
            "p2_as_printed_srgan": _as_printed("srgan"),
            "quick": {**_QUICK, **_chosen(RATIOS), "seeds": [0, 1, 2]},
            "smoke": {**_SMOKE, **_chosen((50, 90)), "samples": 200, "ratios": [50, 90], "seeds": [0, 1], "draws": 500},
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
            "paper": {**_PAPER, **_TUNING},
            "quick": {**_QUICK, **_TUNING, "modalities": ["PDC_MF", "E_TH"]},
            "smoke": {**_SMOKE, **_TUNING, "samples": 400, "ratios": [50]},
        },
        summarise=results.summarise_trials,
        **_SHARED,
    ),
)
