# SPDX-License-Identifier: Apache-2.0
"""The tuning budget of `label_ratio`: as many trials for the PointNet as for the SR-GAN, chosen without the test samples.

At a ratio, a quarter of the samples *that kept their labels* is held back, each network is trained on the other
three quarters as in `label_ratio`, and the trial with the lowest error on what was held back is chosen: one for each
model and ratio, for all modalities alike (`quick` looks at one pressure and one set of electrodes). Neither a test sample nor a label that the ratio withholds has a say. T90's choice
serves T70 too, T50's the ratios with more labels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from foretouch.config import setting
from foretouch.learning.experiments.experiment import Cell, Experiment, Row, Table
from foretouch.learning.experiments.label_ratio import QUICK, SMOKE, NetworkSettings, run_network
from foretouch.learning.experiments.label_ratio_data import load_frozen
from foretouch.learning.experiments.label_ratio_training import MODELS, TRIALS
from foretouch.learning.experiments.simulated_data import SimulatedGrasps, prepare_simulated
from foretouch.learning.split_book import RATIOS
from foretouch.tactile.modalities import MODALITIES

__all__ = ["EXPERIMENT", "LabelRatioTuningSettings"]

_ALL: Final = "all"


@dataclass(frozen=True, kw_only=True)
class LabelRatioTuningSettings(NetworkSettings):
    """Of `label_ratio_tuning`."""

    ratios: tuple[int, ...] = setting((50, 90), "Percent without labels", choices=RATIOS)
    held: float = setting(0.25, "Share of the labelled samples that trials are judged on", minimum=0.01, maximum=0.5)
    seeds: tuple[int, ...] = setting((100,), "Of networks and of who is held back; not those of the runs", minimum=0)


def _cells(settings: LabelRatioTuningSettings, data: SimulatedGrasps) -> list[Cell]:
    del data
    return [
        Cell(
            f"T{ratio}+{model}+{number}+{modality}+{seed}",
            {"ratio": ratio, "model": model, "trial": trial, "modality": modality, "seed": seed},
        )
        for seed in settings.seeds
        for ratio in settings.ratios
        for model in MODELS
        for number, trial in enumerate(TRIALS[model])
        for modality in settings.modalities
    ]


def _run(cell: Cell, settings: LabelRatioTuningSettings, data: SimulatedGrasps) -> list[Row]:
    return run_network(cell, settings, data, held=settings.held, held_seed=cell.values["seed"])


def _tabulate(settings: LabelRatioTuningSettings, rows: Sequence[Row]) -> list[Row]:
    """RMSE over that of the training mean, by modality and over all of them, and which trial is the lowest."""
    result: list[Row] = []
    for ratio in settings.ratios:
        for model in MODELS:
            mine = [row for row in rows if row["ratio"] == ratio and row["model"] == model]
            trials = [one for trial in TRIALS[model] if (one := _trial(settings, mine, trial))]
            lowest = min((one[_ALL] for one in trials), default=None)
            head = {"ratio": ratio, "model": model}
            result += [{**head, **one, "chosen": one[_ALL] == lowest} for one in trials]
    return result


def _trial(settings: LabelRatioTuningSettings, rows: Sequence[Row], trial: str) -> Row | None:
    """One line; None where a network is missing, for the mean of the others would be another."""
    mine = [row for row in rows if row["trial"] == trial]
    if len(mine) != len(settings.modalities) * len(settings.seeds):
        return None
    relative = {name: [_relative(row) for row in mine if row["modality"] == name] for name in settings.modalities}
    means = {name: round(float(np.mean(values)), 5) for name, values in relative.items()}
    first = mine[0]
    facts = {"trial": trial, "labelled": first["labelled"], "held": _count(first), "updates": first["updates"]}
    return {**facts, **means, _ALL: round(float(np.mean(list(means.values()))), 5)}


def _relative(row: Row) -> float:
    """RMSE of a network over that of the training mean."""
    totals = [sum(sum(one[what]) for one in row["objects"].values()) for what in ("squared", "reference")]
    return float(np.sqrt(totals[0] / totals[1]))


def _count(row: Row) -> int:
    return sum(len(one["squared"]) for one in row["objects"].values())


def _summarise(rows: Sequence[Row]) -> list[Table]:
    names = [name for name in (*MODALITIES, _ALL) if name in rows[0]]
    tables = []
    for ratio in dict.fromkeys(row["ratio"] for row in rows):
        mine = [row for row in rows if row["ratio"] == ratio]
        body = [
            [row["model"], row["trial"], *(f"{row[name]:.3f}" for name in names), "chosen" if row["chosen"] else ""]
            for row in mine
        ]
        title = f"T{ratio}: RMSE over that of the training mean, on {mine[0]['held']} held back"
        tables.append(Table(title, ["model", "trial", *names, ""], body))
    return tables


EXPERIMENT = Experiment(
    name="label_ratio_tuning",
    question="Which of as many trials for each model is the best on samples held back from training?",
    module=__name__,
    settings=LabelRatioTuningSettings,
    presets={
        "paper": {},
        "quick": {**QUICK, "modalities": ["PDC_MF", "E_TH"]},
        "smoke": {**SMOKE, "samples": 400, "ratios": [50]},
    },
    load=load_frozen,
    cells=_cells,
    run=_run,
    tabulate=_tabulate,
    summarise=_summarise,
    prepare=prepare_simulated,
)
