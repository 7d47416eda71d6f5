# SPDX-License-Identifier: Apache-2.0
"""P2's Fig. 3 on the simulated deformables: does an SR-GAN need fewer labels than a PointNet?

Of 3200 training samples 10, 30, 50, 70 or 90 % lose their labels (T10...T90). The SR-GAN is trained on all of them and
on fake clouds, the PointNet on the labelled ones; both are tested on the same 800 samples, in several runs, with one
network per modality. The mean of the remaining labels, and trees on the geometry of the grasps with these labels, are
the baselines. `training` describes how both are trained, `results` how they are compared, and `label_ratio_tuning` how
the trials in the presets were chosen.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

from foretouch.config import Settings, setting
from foretouch.errors import ConfigError
from foretouch.experiments.framework.experiment import Cell, Experiment, Row
from foretouch.experiments.label_ratio.data import RatioDataSettings, load_frozen, prepared, split_at
from foretouch.experiments.label_ratio.results import TREES, compare_models, draw_label_ratio_figure, summarise
from foretouch.experiments.label_ratio.training import (
    AS_PRINTED,
    MODELS,
    configured,
    error_row,
    kind_of,
    train_and_predict,
)
from foretouch.experiments.shared.simulated_data import SimulatedGrasps, prepare_simulated
from foretouch.learning.data import labels_of
from foretouch.learning.data.splits import RATIOS
from foretouch.learning.evaluation.baselines import geometry_trees
from foretouch.learning.training.srgan import SrganConfig
from foretouch.models.network.config import ModelConfig
from foretouch.tactile import MODALITIES, columns

__all__ = [
    "EXPERIMENT",
    "PAPER",
    "QUICK",
    "SMOKE",
    "ChosenTrials",
    "LabelRatioSettings",
    "NetworkSettings",
    "run_network",
]

_RECIPE: Final = {"optimiser": "adamw", "learning_rate": 3e-3, "schedule": "cosine", "target_scaling": "standardised"}
"""The trials are changes of this recipe, so their rates and weight decays belong to it."""

PAPER: Final[dict[str, Any]] = {"model": {"metric_inputs": True}, "training": _RECIPE}
"""P2's sizes, epochs and batches of its SR-GAN, with the recipe of the trials and the size of the object as input."""

QUICK: Final[dict[str, Any]] = {
    "stock": 512,
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
"""64 of 750 points, features of 64 instead of 1024 values, no T-Net, a generator of 64 points."""

SMOKE: Final[dict[str, Any]] = {**QUICK, "updates": 40}


@dataclass(frozen=True, kw_only=True)
class NetworkSettings(RatioDataSettings):
    """Settings that both models of `label_ratio` share; the defaults are P2's sizes and recipe."""

    modalities: tuple[str, ...] = setting(MODALITIES, "Modalities; one network each", choices=MODALITIES)
    updates: int | None = setting(
        None, "Updates of each network at every ratio; by default from training.epochs", minimum=1, maximum=10_000_000
    )
    model: ModelConfig = ModelConfig(channels="xyz+normals")
    training: SrganConfig = SrganConfig()

    def __post_init__(self) -> None:
        super().__post_init__()
        taken = max(self.model.n_points, self.training.points or 0)
        if self.stock < taken:
            raise ConfigError(f"{type(self).__name__}.stock: {self.stock} points are fewer than the network's {taken}")


@dataclass(frozen=True, kw_only=True)
class ChosenTrials(Settings):
    """Trials of one model at each ratio, as chosen by `label_ratio_tuning`."""

    pressure: tuple[str, ...] = setting((), "Trials for PDC_TH and PDC_MF")
    electrodes: tuple[str, ...] = setting((), "Trials for E_TH and E_MF")


@dataclass(frozen=True, kw_only=True)
class LabelRatioSettings(NetworkSettings):
    """Settings of `label_ratio`."""

    ratios: tuple[int, ...] = setting(RATIOS, "Percent without labels", choices=RATIOS)
    seeds: tuple[int, ...] = setting((0, 1, 2, 3, 4), "Seeds of the runs: five in P2", minimum=0)
    draws: int = setting(10_000, "Bootstrap samples for the intervals", minimum=100, maximum=1_000_000)
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
        """Chosen trial of a network."""
        chosen: tuple[str, ...] = getattr(getattr(self, model), kind_of(modality))
        return chosen[self.ratios.index(ratio)]


def run_network(
    cell: Cell, settings: NetworkSettings, data: SimulatedGrasps, *, held_out: float = 0.0, held_out_seed: int = 0
) -> list[Row]:
    """Train and test the network of a cell with `ratio`, `model`, `trial`, `modality` and `seed`.

    Args:
        cell: The cell.
        settings: Settings of the experiment.
        data: The samples.
        held_out: Share of the labelled samples to test on instead of the test samples.
        held_out_seed: Seed of these.
    """
    values = cell.values
    model, modality, seed = (values[key] for key in ("model", "modality", "seed"))
    split = split_at(data.collection, values["ratio"], held_out, held_out_seed)
    inputs = prepared(data, settings.model.replace(outputs=(modality,)), settings.stock)
    config = configured(settings.training, model, values["trial"], len(split.train), settings.updates, seed)
    as_printed = values["trial"] in AS_PRINTED[model]
    predicted, updates = train_and_predict(inputs, split, model, config, as_printed=as_printed)
    objects = [data.collection.samples[k].object for k in split.test]
    return [{"updates": updates, **error_row(inputs, split, predicted, objects)}]


def _cells(settings: LabelRatioSettings, data: SimulatedGrasps) -> list[Cell]:
    """The trees, then run by run, so that an interrupted sweep covers the whole figure."""
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
    """Trees that are trained on the labelled samples alone.

    For all modalities at once, also those that are not asked for: a run may be extended by further ones.
    """
    samples = data.collection.samples
    split = split_at(data.collection, cell.values["ratio"])
    train, test = ([samples[k] for k in index] for index in (split.train, split.test))
    predicted = geometry_trees(train, labels_of(train), test, cell.values["seed"])
    objects = [sample.object for sample in test]
    rows = []
    for name in MODALITIES:
        inputs = prepared(data, settings.model.replace(outputs=(name,)), settings.stock)
        rows.append({"modality": name, **error_row(inputs, split, predicted[:, columns([name])], objects)})
    return rows


def _tabulate(settings: LabelRatioSettings, rows: Sequence[Row]) -> list[Row]:
    return compare_models(rows, settings.model.ranges, settings.draws)


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


def _as_printed(reading: str) -> dict[str, dict[str, list[str]]]:
    """P2's recipe at every ratio, in one reading of its losses."""
    trials = {"pointnet": "P2", "srgan": f"P2, {reading}"}
    return {
        model: {kind: [trial] * len(RATIOS) for kind in ("pressure", "electrodes")} for model, trial in trials.items()
    }


EXPERIMENT = Experiment(
    name="label_ratio",
    question="Does an SR-GAN need fewer labels than a PointNet of the same size that is trained alike?",
    module=__name__,
    order=110,
    settings=LabelRatioSettings,
    presets={
        "paper": {**PAPER, **_chosen(RATIOS)},
        "p2_as_printed": _as_printed("as_printed"),
        "p2_as_printed_contrast": _as_printed("contrast"),
        "p2_as_printed_srgan": _as_printed("srgan"),
        "quick": {**QUICK, **_chosen(RATIOS), "seeds": [0, 1, 2]},
        "smoke": {**SMOKE, **_chosen((50, 90)), "samples": 200, "ratios": [50, 90], "seeds": [0, 1], "draws": 500},
    },
    load=load_frozen,
    cells=_cells,
    run=_run,
    tabulate=_tabulate,
    summarise=summarise,
    figure=draw_label_ratio_figure,
    prepare=prepare_simulated,
    resumable_settings=("modalities", "ratios", "seeds", "draws", *MODELS),
)
