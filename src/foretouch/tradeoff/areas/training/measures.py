# SPDX-License-Identifier: Apache-2.0
"""Skill of a training on held-out grasps, and the time that it takes the computer and the robot."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

import numpy as np

from foretouch.config import setting
from foretouch.experiments.framework.experiment import Cell, Row
from foretouch.experiments.shared.folds import some_grasps, some_objects, split_by_fold
from foretouch.experiments.shared.predictors import network
from foretouch.experiments.shared.scores import error_rows, labelled
from foretouch.experiments.shared.simulated_data import beside, simulate_store
from foretouch.learning.data import Dataset, labels_of, load_dataset, make_folds
from foretouch.learning.evaluation.metrics import MEAN as MEAN_SKILL
from foretouch.learning.evaluation.metrics import BootstrapConfig, ObjectErrors, skills
from foretouch.learning.training.contact import ContactConfig, fit_contact
from foretouch.models.contact.estimator import ContactEstimator
from foretouch.tactile import MODALITIES
from foretouch.tradeoff.area import Answer, Timed, TradeoffSettings, Variant
from foretouch.tradeoff.areas.model.contact import Described
from foretouch.tradeoff.areas.training.variants import list_variants
from foretouch.types import Float64, GraspSample

SPLITS: Final = {"known": "time", "new": "object"}
"""Column of the skill, and the folds that it is measured on."""

ONE_BLOCK: Final = "one_block"
"""Column of the skill on the first block of time alone, which is all that networks are trained for."""

_FIRST: Final = "block 0"  # its name
_FIT_S: Final = 3.5  # of a contact model of 60 trees for 320 grasps
_EPOCH_S: Final = 0.4  # of the network as shipped, for 320 grasps
_ENDLESS: Final = 100_000  # epochs of a trainer that is timed epoch by epoch
_COMPARED: Final = 10  # predictions of each model that are compared


@dataclass(frozen=True, kw_only=True)
class TrainingSettings(TradeoffSettings):
    """Settings of the area `training`."""

    trees: int = setting(60, "Trees of each forest of the contact model", minimum=1, maximum=1000)
    detail: str = setting("all", "few: contact models of some sizes; all: also networks", choices=("few", "all"))
    splits: tuple[str, ...] = setting(tuple(SPLITS), "Skills of contact models to measure", choices=tuple(SPLITS))
    scene: str = setting("config/scenes/deformables.yaml", "Scene of the grasps where no recordings are given")
    samples: int = setting(200, "Grasps to simulate there", minimum=100, maximum=100_000)
    bootstrap: BootstrapConfig = BootstrapConfig()


def prepare(settings: TrainingSettings, source: Path | None, out: Path) -> Path:
    """Recordings, or else a simulated store beside `out`."""
    return simulate_store(Path(settings.scene), settings.samples, beside(out)) if source is None else source


def load(settings: TrainingSettings, path: Path) -> Dataset:
    """Read the grasps."""
    del settings
    return load_dataset(path)


def cells(settings: TrainingSettings, data: Dataset) -> list[Cell]:
    """A cell for each variant and split; networks are trained once, for the first block of time."""
    del data
    made = []
    for number, one in enumerate(list_variants(settings.detail)):
        values = {"variant": one.name, **one.values}
        if one.values["kind"] == "network":
            made.append(Cell(f"{number:03}", {**values, "column": ONE_BLOCK, "trains": 1}))
            continue
        columns = ("new",) if "objects" in values else settings.splits  # fewer objects: a question about new ones
        made += [
            Cell(f"{number:03}_{column}", {**values, "column": column})
            for column in columns
            if column in settings.splits
        ]
    return made


def run(cell: Cell, settings: TrainingSettings, data: Dataset) -> list[Row]:
    """Errors on all folds of the split, or on the first one."""
    samples = labelled(data)
    split = SPLITS.get(cell.values["column"], "time")
    folds = make_folds(samples, split, 0)
    grasp_s = robot_seconds(samples)
    rows: list[Row] = []
    for fold in folds[:1] if cell.values["column"] == ONE_BLOCK else folds:
        train, test = split_by_fold(samples, folds, fold.name)
        chosen = chosen_samples(cell.values, train)
        predicted = _predict(cell.values, settings, _described(data), chosen, test)
        mean = labels_of(train).mean(axis=0)
        head = {"part": fold.name, "train": len(chosen), "robot_h": len(chosen) * grasp_s / 3600.0}
        rows += [{**head, **row} for row in error_rows(test, predicted, labels_of(test), mean)]
    return rows


def chosen_samples(values: Any, train: Sequence[GraspSample]) -> list[GraspSample]:
    """The training samples of a variant; all if it has fewer than it asks for."""
    if (grasps := values.get("grasps")) is not None:
        fewest = min(sum(one.object == name for one in train) for name in {one.object for one in train})
        return some_grasps(train, min(grasps, fewest), 0)
    if (objects := values.get("objects")) is not None:
        return some_objects(train, min(objects, len({one.object for one in train})), 0)
    return list(train)


@lru_cache(maxsize=1)
def _described(data: Dataset) -> Described:
    return Described(labelled(data))


def fit(
    values: Any, settings: TrainingSettings, described: Described, train: Sequence[GraspSample]
) -> ContactEstimator:
    """A contact model as the variant has it, from features that are computed once for all variants."""
    config = ContactConfig(trees=settings.trees).updated(values.get("changes", {}))
    index = described.index(train)
    thinned = None if config.thinned == 1.0 else described.rows("thinned")[index]
    names = [one.object for one in train]
    return fit_contact(described.rows("hand")[index], described.labels[index], names, config, thinned)


def _predict(
    values: Any,
    settings: TrainingSettings,
    described: Described,
    train: Sequence[GraspSample],
    test: Sequence[GraspSample],
) -> Float64:
    if values["kind"] == "mean":
        return np.tile(labels_of(train).mean(axis=0), (len(test), 1))
    if values["kind"] == "network":
        return network("touchnet_v1", 1.0, values["changes"])(train, labels_of(train), test, 0)
    return fit(values, settings, described, train).predict_rows(described.rows("hand")[described.index(test)])[0]


def tabulate(settings: TrainingSettings, rows: Sequence[Row]) -> list[Row]:
    """A row for each variant: mean skill on each split, its interval over objects, and skill by modality."""
    result = []
    for name in dict.fromkeys(row["variant"] for row in rows):
        own = [row for row in rows if row["variant"] == name]
        row: Row = {"variant": name}
        for column in SPLITS:
            row |= _scores(column, [one for one in own if one["column"] == column], settings.bootstrap)
        block = [one for one in own if one["column"] in ("known", ONE_BLOCK) and one["part"] == _FIRST]
        row |= _scores(ONE_BLOCK, block, settings.bootstrap)
        for column in (*SPLITS, ONE_BLOCK):
            parts = [one for one in own if one["column"] == column]
            row[f"grasps_{column}"] = round(float(np.mean([one["train"] for one in parts]))) if parts else None
            row[f"robot_h_{column}"] = round(float(np.mean([one["robot_h"] for one in parts])), 3) if parts else None
        result.append(row)
    return result


def _scores(column: str, rows: Sequence[Row], bootstrap: BootstrapConfig) -> Row:
    names = (column, f"{column}_low", f"{column}_high", *(f"{column}_{modality}" for modality in MODALITIES))
    if not rows:
        return dict.fromkeys(names)
    parts = [(one["object"], one["count"], np.array(one["squared"]), np.array(one["reference"])) for one in rows]
    found = skills(ObjectErrors.total(parts), bootstrap)
    mean = found[MEAN_SKILL]
    values = (mean.value, mean.low, mean.high, *(found[modality].value for modality in MODALITIES))
    return {name: None if value is None else round(value, 5) for name, value in zip(names, values, strict=True)}


def seconds(settings: TrainingSettings, data: Dataset, left: Sequence[Cell]) -> float:
    """From the time of a fit and of an epoch on the machine of the benchmarks, by size."""
    total, share = 0.0, len(labelled(data)) / 400.0
    for cell in left:
        values = cell.values
        if values["kind"] == "network":
            total += share * _EPOCH_S * values["epochs"] * values["changes"].get("train.points", 256) / 256.0
        elif values["kind"] == "contact":
            folds = 5 if values["column"] == "known" else 8
            part = min(values.get("grasps", 40) / 40.0, values.get("objects", 7) / 7.0)
            trees = values.get("changes", {}).get("trees", settings.trees)
            total += share * folds * part * _FIT_S * (trees + 10.0) / 70.0
    return total


def timed(variant: Variant, settings: TrainingSettings, data: Dataset) -> Timed:
    """See `Area.timed`: one fit of a contact model, or one epoch of a network, of the first block of time.

    The features of a contact model are computed before: they cost the same at each setting, about 6 ms a grasp. Its
    answers are predictions of some test samples [counts]; an epoch answers nothing.
    """
    train, test = first_block(data)
    chosen = chosen_samples(variant.values, train)
    if variant.values["kind"] == "network":
        return _timed_network(variant, chosen)

    def training(request: int) -> Answer:
        del request
        return _predict(variant.values, settings, _described(data), chosen, test[:_COMPARED])

    return Timed(training)


@lru_cache(maxsize=1)
def first_block(data: Dataset) -> tuple[list[GraspSample], list[GraspSample]]:
    """Training and test samples of the first block of time."""
    samples = labelled(data)
    folds = make_folds(samples, "time", 0)
    return split_by_fold(samples, folds, folds[0].name)


def _timed_network(variant: Variant, train: Sequence[GraspSample]) -> Timed:
    from foretouch.learning.data import TrainingSet
    from foretouch.learning.training.learners import load_run_config
    from foretouch.learning.training.supervised import SupervisedTrainer

    recipe: Any = load_run_config("touchnet-v1").updated(variant.values["changes"])
    endless = recipe.train.replace(epochs=_ENDLESS)
    trainer = SupervisedTrainer(TrainingSet.build(train, recipe.model), np.arange(len(train)), endless)

    def epoch(request: int) -> Answer:
        del request
        trainer.run_epoch()
        return np.zeros(0)

    return Timed(epoch, whole=float(recipe.train.epochs))


def robot_seconds(samples: Sequence[GraspSample]) -> float:
    """Median time from one grasp of an object to the next, as they were recorded; 0 of simulated ones [s]."""
    gaps: list[float] = []
    for name in {one.object for one in samples}:
        gaps += list(np.diff(sorted(one.stamp_ns for one in samples if one.object == name)) / 1e9)
    return float(np.median(gaps)) if gaps else 0.0
