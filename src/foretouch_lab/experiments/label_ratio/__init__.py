# SPDX-License-Identifier: Apache-2.0
"""P2's Fig. 3 on the simulated deformables: does an SR-GAN need fewer labels than a PointNet?

Of 3200 training samples 10, 30, 50, 70 or 90 % lose their labels (T10...T90). The SR-GAN is trained on all of them and
on fake clouds, the PointNet on the labelled ones; both are tested on the same 800 samples, in several runs, with one
network per modality. The mean of the remaining labels, and trees on the geometry of the grasps with these labels, are
the baselines. `training` describes how both are trained, `results` how they are compared.

Both models are trained by the recipe that had the lowest error among six of each on held-out labelled samples, at T50
and T90 (docs/results/earlier.md); neither test samples nor labels
that a ratio withholds were used to choose it. The preset `p2_as_printed` trains both by P2's own recipe.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

from foretouch.config import Settings, setting
from foretouch.errors import ConfigError
from foretouch.models.network.config import ModelConfig
from foretouch.tactile import BIOTAC, MODALITIES
from foretouch_lab.experiments.framework.experiment import Cell, Experiment, Row
from foretouch_lab.experiments.label_ratio.results import CHOSEN, TREES, compare_models, draw_models, summarise_models
from foretouch_lab.experiments.label_ratio.training import (
    MODELS,
    POINTNET,
    READINGS,
    SRGAN,
    configured,
    error_row,
    prepare_simulated,
    prepared,
    train_and_predict,
)
from foretouch_lab.learning.data import Dataset, labels_of
from foretouch_lab.learning.data.splits import RATIOS
from foretouch_lab.learning.evaluation.baselines import geometry_trees
from foretouch_lab.learning.training.srgan import SrganConfig

__all__ = ["EXPERIMENT"]


@dataclass(frozen=True, kw_only=True)
class LabelRatioSettings(Settings):
    """Settings of `label_ratio`; the defaults are P2's sizes and recipe."""

    samples: int = setting(4000, "Number of grasps to simulate if --data is a scene", bounds=(10, 1_000_000))
    cached_points: int = setting(
        2048,
        "Points of each cloud that are kept in memory, drawn once; training draws from these each time. At least as many as the network takes",
        minimum=32,
    )
    modalities: tuple[str, ...] = setting(MODALITIES, "Modalities; one network each", choices=MODALITIES)
    ratios: tuple[int, ...] = setting(RATIOS, "Percentages of the training samples without labels", choices=RATIOS)
    seeds: tuple[int, ...] = setting((0, 1, 2, 3, 4), "Seeds of the runs: five in P2", minimum=0)
    updates: int | None = setting(
        None, "Updates of each network at every ratio; by default from training.epochs", bounds=(1, 10_000_000)
    )
    recipe: str = setting(
        CHOSEN, "Training of both models: that chosen on held-out labelled samples, or P2's", choices=(CHOSEN, "P2")
    )
    readings: tuple[str, ...] = setting(
        (), "Trials of the SR-GAN that are compared with the PointNet, in addition to the recipe's"
    )
    draws: int = setting(10_000, "Number of bootstrap samples for the intervals", bounds=(100, 1_000_000))
    model: ModelConfig = ModelConfig(channels="xyz+normals")
    training: SrganConfig = SrganConfig()

    def __post_init__(self) -> None:
        super().__post_init__()
        taken = max(self.model.n_points, self.training.points or 0)
        if self.cached_points < taken:
            raise ConfigError(f"cached_points: {self.cached_points} points are fewer than the network's {taken}")

    def chosen(self, model: str, ratio: int, modality: str) -> str:
        """Return the trial of a network."""
        if self.recipe != CHOSEN:
            return {POINTNET: "P2", SRGAN: "P2, as_printed"}[model]
        if model == SRGAN:
            return "batch_means w_U 0.1 w_F 0.01, batch 0.001"
        return "frozen 0.001" if ratio > 50 and modality.startswith("E_") else "batch 0.001"


def _cells(settings: LabelRatioSettings, _data: Dataset) -> list[Cell]:
    """Return the trees, then run by run both models and after them the readings, so that an interrupted sweep covers the figure."""
    pairs = [
        {"ratio": ratio, "modality": modality, "model": model, "seed": seed}
        | {"trial": settings.chosen(model, ratio, modality)}
        for seed in settings.seeds
        for ratio in settings.ratios
        for modality in settings.modalities
        for model in MODELS
    ]
    srgans = [pair for pair in pairs if pair["model"] == SRGAN]
    readings = [{**srgan, "trial": trial} for srgan in srgans for trial in settings.readings]
    trees = [{"ratio": ratio, "model": TREES, "seed": 0} for ratio in settings.ratios]
    return list({cell.key: cell for cell in (Cell(_key(tree), tree) for tree in trees + pairs + readings)}.values())


def _key(values: Row) -> str:
    parts = (f"T{values['ratio']}", values.get("modality", ""), values["model"], values.get("trial", ""))
    return "+".join([*(re.sub(r"[^\w.-]+", "_", part) for part in parts if part), str(values["seed"])])


def _run(cell: Cell, settings: LabelRatioSettings, data: Dataset) -> list[Row]:
    """Train and test one network, or the trees."""
    ratio, model, seed = (cell.values[key] for key in ("ratio", "model", "seed"))
    split = data.partition(f"labels/T{ratio}")
    if model == TREES:
        # For all modalities at once, also those that are not asked for: a run may be extended by further ones.
        train, test = split.sides(data.samples)
        by_trees = geometry_trees(train, labels_of(train), test, seed)
        return [
            {"modality": name, **error_row(data, (name,), split, by_trees[:, BIOTAC.columns([name])])}
            for name in MODALITIES
        ]
    inputs = prepared(data, settings.model.replace(outputs=(cell.values["modality"],)), settings.cached_points)
    config = configured(settings.training, model, cell.values["trial"], len(split.train), settings.updates, seed)
    predicted, updates = train_and_predict(inputs, split, model, config)
    return [{"updates": updates, **error_row(data, inputs.config.outputs, split, predicted)}]


def _tabulate(settings: LabelRatioSettings, rows: Sequence[Row]) -> list[Row]:
    return [
        {"srgan": name, **row}
        for name in (CHOSEN, *settings.readings)
        for row in compare_models(_rows_of(settings, rows, name), settings.model.ranges.ranges, settings.draws)
    ]


def _rows_of(settings: LabelRatioSettings, rows: Sequence[Row], name: str) -> list[Row]:
    """Return rows of trees and PointNet, and rows of the SR-GAN in the trial `name`."""
    return [
        row
        for row in rows
        if row["model"] != SRGAN
        or row["trial"] == (settings.chosen(SRGAN, row["ratio"], row["modality"]) if name == CHOSEN else name)
    ]


# The trials are changes of this recipe. `bfloat16` is the precision of the search for winning points alone.
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
    "updates": 40,
    "model": {"n_points": 64, "channels": "xyz+normals", "tnet": False, "trunk_widths": [32, 64], "head_widths": [64]},
    "training": {**_RECIPE, "batch_size": 16, "generator": {"noise_length": 1, "widths": [16], "stride": 8}},
}

# Three runs, in each reading of P2's losses.
_RUNS: Final[dict[str, Any]] = {"seeds": [0, 1, 2], "readings": READINGS}

EXPERIMENT: Final = Experiment(
    name="label_ratio",
    question="Does an SR-GAN need fewer labels than a PointNet of the same size that is trained alike?",
    module=__name__,
    settings=LabelRatioSettings,
    presets={
        "quick": {**_QUICK, **_RUNS, "ratios": [10, 50, 90]},
        "paper": {**_PAPER, **_RUNS, "ratios": [90]},
        "p2_as_printed": {"recipe": "P2", "readings": ["P2, contrast", "P2, batch_means", "P2, srgan"]},
        "smoke": {**_SMOKE, **_RUNS, "samples": 200, "ratios": [50, 90], "seeds": [0, 1], "draws": 500},
    },
    cells=_cells,
    run=_run,
    tabulate=_tabulate,
    summarise=summarise_models,
    figure=draw_models,
    prepare=prepare_simulated,
    resumable_settings=("modalities", "ratios", "seeds", "draws", "readings"),
)
