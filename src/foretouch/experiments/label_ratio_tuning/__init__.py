# SPDX-License-Identifier: Apache-2.0
"""Hyperparameters of `label_ratio`: as many trials for the PointNet as for the SR-GAN, chosen without the test samples.

At a ratio, a quarter of the samples *that kept their labels* is held out, each network is trained on the other three
quarters as in `label_ratio`, and the trial with the lowest error on the held-out samples is chosen: one for each model,
ratio and kind of modality, pressures or electrodes (`quick` runs one modality of each kind). Neither test samples nor
labels that the ratio withholds are used. T90's choice is used at T70 too, T50's at the ratios with more labels.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from foretouch.config import setting
from foretouch.experiments.framework.experiment import Cell, Experiment, Row, Table
from foretouch.experiments.label_ratio import PAPER, QUICK, SMOKE, NetworkSettings, run_network
from foretouch.experiments.label_ratio.data import load_frozen
from foretouch.experiments.label_ratio.training import MODELS, TRIALS, kind_of
from foretouch.experiments.shared.simulated_data import SimulatedGrasps, prepare_simulated
from foretouch.learning.data.splits import RATIOS

__all__ = ["EXPERIMENT", "LabelRatioTuningSettings"]


@dataclass(frozen=True, kw_only=True)
class LabelRatioTuningSettings(NetworkSettings):
    """Settings of `label_ratio_tuning`."""

    ratios: tuple[int, ...] = setting((50, 90), "Percent without labels", choices=RATIOS)
    held: float = setting(0.25, "Share of the labelled samples that trials are tested on", minimum=0.01, maximum=0.5)
    seeds: tuple[int, ...] = setting((100,), "Seeds of networks and held-out samples; not those of the runs", minimum=0)


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
    return run_network(cell, settings, data, held_out=settings.held, held_out_seed=cell.values["seed"])


def _tabulate(settings: LabelRatioTuningSettings, rows: Sequence[Row]) -> list[Row]:
    """RMSE relative to the training mean, averaged over the modalities of a kind; the lowest trial is chosen."""
    kinds = dict.fromkeys(kind_of(name) for name in settings.modalities)
    result: list[Row] = []
    for ratio, kind, model in product(settings.ratios, kinds, MODELS):
        subset = [r for r in rows if (r["ratio"], r["model"], kind_of(r["modality"])) == (ratio, model, kind)]
        wanted = len(settings.seeds) * sum(kind_of(name) == kind for name in settings.modalities)
        trials = [
            _trial(trial, subset) for trial in TRIALS[model] if sum(r["trial"] == trial for r in subset) == wanted
        ]
        lowest = min((one["relative_rmse"] for one in trials), default=None)
        head = {"ratio": ratio, "kind": kind, "model": model}
        result += [{**head, **one, "chosen": one["relative_rmse"] == lowest} for one in trials]
    return result


def _trial(trial: str, rows: Sequence[Row]) -> Row:
    subset = [row for row in rows if row["trial"] == trial]
    columns = {
        "trial": trial,
        "labelled": subset[0]["labelled"],
        "held": _count(subset[0]),
        "updates": subset[0]["updates"],
    }
    return {**columns, "relative_rmse": round(float(np.mean([_relative(row) for row in subset])), 6)}


def _relative(row: Row) -> float:
    """RMSE of a network relative to that of the training mean."""
    totals = [sum(sum(one[what]) for one in row["objects"].values()) for what in ("squared", "reference")]
    return float(np.sqrt(totals[0] / totals[1]))


def _count(row: Row) -> int:
    return sum(len(one["squared"]) for one in row["objects"].values())


def _summarise(rows: Sequence[Row]) -> list[Table]:
    tables = []
    for ratio, kind in dict.fromkeys((row["ratio"], row["kind"]) for row in rows):
        subset = [row for row in rows if (row["ratio"], row["kind"]) == (ratio, kind)]
        body = [
            [row["model"], row["trial"], f"{row['relative_rmse']:.3f}", "chosen" if row["chosen"] else ""]
            for row in subset
        ]
        title = f"T{ratio}, {kind}: RMSE relative to the training mean, on {subset[0]['held']} held-out samples"
        tables.append(Table(title, ["model", "trial", "relative RMSE", ""], body))
    return tables


EXPERIMENT = Experiment(
    name="label_ratio_tuning",
    question="Which of an equal number of trials per model has the lowest error on held-out training samples?",
    module=__name__,
    order=120,
    settings=LabelRatioTuningSettings,
    presets={
        "paper": PAPER,
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
