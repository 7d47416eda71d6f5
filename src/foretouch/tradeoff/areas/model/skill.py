# SPDX-License-Identifier: Apache-2.0
"""Skill of each model on folds of the real grasps; all models of a fold share what is fitted alike."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from foretouch.config import setting
from foretouch.errors import ConfigError
from foretouch.experiments.framework.experiment import Cell, Row
from foretouch.experiments.shared.folds import split_by_fold
from foretouch.experiments.shared.real_grasps import error_rows, labelled
from foretouch.learning.data import Dataset, labels_of, make_folds
from foretouch.learning.evaluation.metrics import MEAN as MEAN_SKILL
from foretouch.learning.evaluation.metrics import BootstrapConfig, ObjectErrors, skills
from foretouch.learning.training.contact import ContactConfig, ContactPredictor
from foretouch.models.contact.estimator import ContactEstimator
from foretouch.tactile import MODALITIES
from foretouch.tradeoff.area import TradeoffSettings, Variant
from foretouch.tradeoff.areas.model import variants as listed
from foretouch.tradeoff.areas.model.cheaper import fewer_trees
from foretouch.types import Float64

SPLITS: Final = {"random": "random folds", "time": "blocks of time", "object": "objects left out"}
"""Splits of the real grasps, with what is held out."""


@dataclass(frozen=True, kw_only=True)
class ModelSettings(TradeoffSettings):
    """Settings of the area `model`."""

    requests: tuple[int, ...] = setting((1, 10, 100, 1000), "Grasps per cloud that are timed", minimum=1)
    splits: tuple[str, ...] = setting(tuple(SPLITS), "Splits on which skill is measured", choices=tuple(SPLITS))
    seeds: tuple[int, ...] = setting((0,), "Seeds of random folds and of the trees", minimum=0)
    bootstrap: BootstrapConfig = BootstrapConfig()

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.splits or not self.seeds:
            raise ConfigError("ModelSettings.splits, seeds: must hold at least one value")


def cells(settings: ModelSettings, data: Dataset) -> list[Cell]:
    """A cell for each fold and seed, which fits all models."""
    return [
        Cell(f"{split}+{fold.name}+seed{seed}".replace(" ", "_"), {"split": split, "part": fold.name, "seed": seed})
        for split in settings.splits
        for seed in settings.seeds
        for fold in make_folds(labelled(data), split, seed)
    ]


def run(cell: Cell, settings: ModelSettings, data: Dataset) -> list[Row]:
    """Errors of all models on one fold."""
    del settings
    split, part, seed = (cell.values[key] for key in ("split", "part", "seed"))
    samples = labelled(data)
    train, test = split_by_fold(samples, make_folds(samples, split, seed), part)
    predictor = ContactPredictor(train, labels_of(train), ContactConfig(seed=seed))
    rows = ContactPredictor(test, labels_of(test), ContactConfig(seed=seed, thinned=1.0)).rows
    labels, mean = labels_of(test), labels_of(train).mean(axis=0)
    result = []
    for variant in listed.list_variants():
        predicted = _predict(variant, predictor, rows, mean)
        if predicted is not None:
            errors = error_rows(test, predicted, labels, mean)
            result += [{"variant": variant.name, **row} for row in errors]
    return result


def _predict(variant: Variant, predictor: ContactPredictor, rows: Float64, mean: Float64) -> Float64 | None:
    """(S, 50) predictions of a model for described grasps; None if its skill is not measured."""
    if variant.values["kind"] == "mean":
        return np.tile(mean, (len(rows), 1))
    if variant.values["kind"] == "contact":
        return contact_variant(variant, predictor.estimator).predict_rows(rows)[0]
    return None


def contact_variant(variant: Variant, estimator: ContactEstimator) -> ContactEstimator:
    """A contact model as the variant has it, made from the fitted one."""
    if "trees" in variant.values:
        return fewer_trees(estimator, variant.values["trees"])
    return estimator


def tabulate(settings: ModelSettings, rows: Sequence[Row]) -> list[Row]:
    """A row for each model: on each split the skill with its interval, its deviation over folds, and the errors."""
    result = []
    for name in dict.fromkeys(row["variant"] for row in rows):
        row: Row = {"variant": name}
        for split in settings.splits:
            own = [one for one in rows if (one["variant"], one["split"]) == (name, split)]
            row |= _scores(split, own, settings.bootstrap)
        result.append(row)
    return result


def _scores(split: str, rows: Sequence[Row], bootstrap: BootstrapConfig) -> Row:
    errors = _errors(rows)
    found = skills(errors, bootstrap)
    mean = found[MEAN_SKILL]
    folds = {(one["part"], one["seed"]) for one in rows}
    each = [
        skills(_errors([one for one in rows if (one["part"], one["seed"]) == fold]), bootstrap.replace(draws=100))
        for fold in folds
    ]
    row: Row = {split: mean.value, f"{split}_low": mean.low, f"{split}_high": mean.high}
    row |= {f"{split}_sd": float(np.std([one[MEAN_SKILL].value for one in each]))}
    row |= {f"{split}_{modality}": found[modality].value for modality in MODALITIES}
    row |= {f"{split}_rmse_{modality}": value for modality, value in errors.rmse().items()}
    return {key: None if value is None else round(value, 5) for key, value in row.items()}


def _errors(rows: Sequence[Row]) -> ObjectErrors:
    return ObjectErrors.total(
        [(one["object"], one["count"], np.array(one["squared"]), np.array(one["reference"])) for one in rows]
    )
