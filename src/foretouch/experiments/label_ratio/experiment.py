# SPDX-License-Identifier: Apache-2.0
"""P2's Fig. 3 on the simulated deformables: does an SR-GAN need fewer labels than a PointNet?

Of 3200 training samples 10, 30, 50, 70 or 90 % lose their labels (T10...T90). The SR-GAN learns from all of them and from
fake clouds, the PointNet from those with labels; both are judged on the same 800 test samples, in several runs, each
modality by a network of its own. Beside them stand the mean of the labels that were kept and trees that learned from
these on the geometry of the grasps, for a gain over a network that trees outdo is worth knowing as such.
`label_ratio_training` tells how both are trained, `label_ratio_table` how they are compared, and `label_ratio_tuning` how
the trials that stand in the presets were chosen.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

from foretouch.config import Settings, setting
from foretouch.errors import ConfigError
from foretouch.experiments.framework.experiment import Cell, Experiment, Row
from foretouch.experiments.label_ratio.data import RatioDataSettings, load_frozen, prepared, sides
from foretouch.experiments.label_ratio.table import TREES, compare_models, summarise
from foretouch.experiments.label_ratio.training import (
    MODELS,
    configured,
    error_row,
    kind_of,
    train_and_predict,
)
from foretouch.experiments.shared.simulated_data import SimulatedGrasps, prepare_simulated
from foretouch.learning.data.splits import RATIOS
from foretouch.learning.data.training_set import labels_of
from foretouch.learning.evaluation.baselines import geometry_trees
from foretouch.learning.training.srgan import SrganConfig
from foretouch.models.network.config import ModelConfig
from foretouch.tactile.modalities import MODALITIES, columns

__all__ = ["EXPERIMENT", "QUICK", "SMOKE", "ChosenTrials", "LabelRatioSettings", "NetworkSettings", "run_network"]

QUICK: Final[dict[str, Any]] = {
    "updates": 960,
    "model": {
        "n_points": 64,
        "channels": "xyz+normals",
        "metric_inputs": True,
        "tnet": False,
        "trunk_widths": [32, 64],
        "head_widths": [64, 32],
    },
    "training": {
        "batch_size": 16,
        "optimiser": "adamw",
        "learning_rate": 3e-3,
        "schedule": "cosine",
        "target_scaling": "standardised",
        "generator": {"noise_length": 1, "widths": [16], "stride": 8},
    },
}
"""64 of 750 points, features of 64 instead of 1024 values, no T-Net, a generator of 64 points."""

SMOKE: Final[dict[str, Any]] = {**QUICK, "updates": 40}


@dataclass(frozen=True, kw_only=True)
class NetworkSettings(RatioDataSettings):
    """What both models of `label_ratio` share; the defaults are P2's sizes and recipe."""

    modalities: tuple[str, ...] = setting(MODALITIES, "One network each", choices=MODALITIES)
    updates: int | None = setting(
        None, "Of each network, at every ratio; by default those of training.epochs", minimum=1, maximum=10_000_000
    )
    model: ModelConfig = ModelConfig(channels="xyz+normals")
    training: SrganConfig = SrganConfig()


@dataclass(frozen=True, kw_only=True)
class ChosenTrials(Settings):
    """Of one model, the trial at each ratio, as `label_ratio_tuning` chose them."""

    pressure: tuple[str, ...] = setting((), "Of PDC_TH and PDC_MF")
    electrodes: tuple[str, ...] = setting((), "Of E_TH and E_MF")


@dataclass(frozen=True, kw_only=True)
class LabelRatioSettings(NetworkSettings):
    """Of `label_ratio`."""

    ratios: tuple[int, ...] = setting(RATIOS, "Percent without labels", choices=RATIOS)
    seeds: tuple[int, ...] = setting((0, 1, 2, 3, 4), "Of the runs: five in P2", minimum=0)
    draws: int = setting(10_000, "Resamples for the intervals", minimum=100, maximum=1_000_000)
    pointnet: ChosenTrials = ChosenTrials()
    srgan: ChosenTrials = ChosenTrials()

    def __post_init__(self) -> None:
        super().__post_init__()
        for model in MODELS:
            for kind, trials in getattr(self, model).to_mapping().items():
                if len(trials) != len(self.ratios):
                    raise ConfigError(
                        f"LabelRatioSettings.{model}.{kind}: {len(trials)} trials are not one for each of "
                        f"{len(self.ratios)} ratios"
                    )

    def trial(self, model: str, ratio: int, modality: str) -> str:
        """Of a network."""
        chosen: tuple[str, ...] = getattr(getattr(self, model), kind_of(modality))
        return chosen[self.ratios.index(ratio)]


def run_network(
    cell: Cell, settings: NetworkSettings, data: SimulatedGrasps, *, held: float = 0.0, held_seed: int = 0
) -> list[Row]:
    """Train and judge the network of a cell with `ratio`, `model`, `trial`, `modality` and `seed`.

    Args:
        cell: The cell.
        settings: Of the experiment.
        data: The samples.
        held: Share of the labelled samples that is judged instead of the test samples.
        held_seed: Of whom that is.
    """
    what = cell.values
    who = sides(data.collection, what["ratio"], held, held_seed)
    ready = prepared(data, settings.model.replace(outputs=(what["modality"],)), settings.stock)
    config = configured(settings.training, what["model"], what["trial"], len(who.train), settings.updates, what["seed"])
    predicted, updates = train_and_predict(ready, who, what["model"], config)
    objects = [data.collection.samples[k].object for k in who.judged]
    return [{"updates": updates, **error_row(ready, who, predicted, objects)}]


def _cells(settings: LabelRatioSettings, data: SimulatedGrasps) -> list[Cell]:
    """The trees, then run by run, so that a sweep that was cut short has every cell of the figure."""
    del data
    trees = [Cell(f"T{ratio}+{TREES}", {"ratio": ratio, "model": TREES, "seed": 0}) for ratio in settings.ratios]
    return trees + [
        Cell(
            f"T{ratio}+{modality}+{model}+{seed}",
            {
                "ratio": ratio,
                "modality": modality,
                "model": model,
                "seed": seed,
                "trial": settings.trial(model, ratio, modality),
            },
        )
        for seed in settings.seeds
        for ratio in settings.ratios
        for modality in settings.modalities
        for model in MODELS
    ]


def _run(cell: Cell, settings: LabelRatioSettings, data: SimulatedGrasps) -> list[Row]:
    return _run_trees(cell, settings, data) if cell.values["model"] == TREES else run_network(cell, settings, data)


def _run_trees(cell: Cell, settings: LabelRatioSettings, data: SimulatedGrasps) -> list[Row]:
    """Trees that see the labelled samples alone, of all modalities at once."""
    samples = data.collection.samples
    who = sides(data.collection, cell.values["ratio"])
    train, judged = ([samples[k] for k in index] for index in (who.train, who.judged))
    predicted = geometry_trees(train, labels_of(train), judged, cell.values["seed"])
    objects = [sample.object for sample in judged]
    rows = []
    for name in settings.modalities:
        ready = prepared(data, settings.model.replace(outputs=(name,)), settings.stock)
        rows.append({"modality": name, **error_row(ready, who, predicted[:, columns([name])], objects)})
    return rows


def _tabulate(settings: LabelRatioSettings, rows: Sequence[Row]) -> list[Row]:
    return compare_models(rows, settings.model.ranges, settings.draws)


def _chosen(ratios: Sequence[int]) -> dict[str, dict[str, list[str]]]:
    """What docs/results/label_ratio_tuning holds; T90's choice serves T70 too, T50's the ratios with more labels."""
    tuned = {
        "pointnet": {
            "pressure": ("rate 0.001, decay 0.3", "rate 0.0003, decay 0.3"),
            "electrodes": ("rate 0.003", "rate 0.001, decay 1"),
        },
        "srgan": {
            "pressure": ("0.3/1/1", "0.3/1/1, rate 0.001, decay 0.3"),
            "electrodes": ("0.3/1/1", "0.3/1/0.3"),
        },
    }
    return {
        model: {kind: [few if ratio >= 70 else many for ratio in ratios] for kind, (many, few) in kinds.items()}
        for model, kinds in tuned.items()
    }


EXPERIMENT = Experiment(
    name="label_ratio",
    question="Does an SR-GAN predict touch from fewer labels than a PointNet of the same size, trained alike?",
    module=__name__,
    settings=LabelRatioSettings,
    presets={
        "paper": _chosen(RATIOS),
        "quick": {**QUICK, **_chosen(RATIOS), "seeds": [0, 1, 2]},
        "smoke": {
            **SMOKE,
            **_chosen((50, 90)),
            "samples": 200,
            "ratios": [50, 90],
            "seeds": [0, 1],
            "draws": 500,
        },
    },
    load=load_frozen,
    cells=_cells,
    run=_run,
    tabulate=_tabulate,
    summarise=summarise,
    prepare=prepare_simulated,
)
