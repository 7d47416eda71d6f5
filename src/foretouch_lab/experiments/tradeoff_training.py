# SPDX-License-Identifier: Apache-2.0
"""Area `training`: grasps, objects, trees, epochs, points and precision against the time of a training and of the robot."""

import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from foretouch.config import setting
from foretouch.types import Float64, GraspSample
from foretouch_lab.experiments.framework.experiment import Cell, Row
from foretouch_lab.experiments.framework.tradeoff import Area, Panel, Timed, TradeoffSettings, Variant
from foretouch_lab.experiments.shared.predictors import network
from foretouch_lab.experiments.shared.scores import error_rows, labelled, load, skill_columns
from foretouch_lab.experiments.shared.simulated_data import beside, simulate_store
from foretouch_lab.experiments.shared.tables import grouped, select
from foretouch_lab.experiments.tradeoff_model import describe
from foretouch_lab.learning.data import Dataset, labels_of, make_folds
from foretouch_lab.learning.evaluation.metrics import BootstrapConfig
from foretouch_lab.learning.training.contact import ContactTrainingConfig, fit_contact

CONTACT: Final = "contact model as shipped"
NETWORK: Final = "network as shipped"
MEAN: Final = "mean of labels"

_SPLITS: Final = {"known": "time", "new": "object"}  # column of the skill, and the folds that it is measured on
_ONE_BLOCK: Final = "one_block"  # column of the skill on the first block of time, all that networks are trained for
_FIRST: Final = "block 0"  # its name
_SCENE: Final = Path("config/scenes/deformables.yaml")  # of the grasps where no recordings are given
_ENDLESS: Final = 100_000  # epochs of a trainer that is timed epoch by epoch
_PREDICTED: Final = 10  # test samples that a fit predicts, when it is timed

# Name, factor, and the values of each variant; the shipped models use all grasps (40 of 50 in a block of time) and objects.
_VARIANTS: Final[tuple[tuple[str, str, Mapping[str, Any]], ...]] = (
    (CONTACT, "shipped", {}),
    (MEAN, "part", {"kind": "mean"}),
    *((f"{count} grasps an object", "labels", {"grasps": count}) for count in (5, 10, 20)),
    *((f"{count} objects", "objects", {"objects": count}) for count in (2, 4)),
    *((f"{count} trees", "trees", {"changes": {"trees": count}}) for count in (5, 15, 120)),
    ("no thinned copies", "copies", {"changes": {"thinned": 1.0}}),
)
_EPOCHS: Final = (10, 30, 60, 240)  # of networks; the shipped one has 120


@dataclass(frozen=True, kw_only=True)
class TrainingSettings(TradeoffSettings):
    """Settings of the area."""

    trees: int = setting(60, "Trees of each forest of the contact model", bounds=(1, 1000))
    splits: tuple[str, ...] = setting(tuple(_SPLITS), "Skills of contact models to measure", choices=tuple(_SPLITS))
    networks: bool = setting(True, "Train networks on the first block of time")
    samples: int = setting(200, "Grasps to simulate where no recordings are given", bounds=(100, 100_000))
    bootstrap: BootstrapConfig = BootstrapConfig()


def _prepare(settings: TrainingSettings, source: Path | None, out: Path) -> Path:
    """Recordings, or else a simulated store beside `out`."""
    return simulate_store(_SCENE, settings.samples, beside(out)) if source is None else source


def _variants(settings: TrainingSettings) -> Iterator[Variant]:
    for name, factor, values in _VARIANTS:
        yield Variant(name, factor, {"kind": "contact", **values})
    if settings.networks:
        yield Variant(NETWORK, "shipped", {"kind": "network", "changes": {}})
        for count in _EPOCHS:
            yield Variant(f"network, {count} epochs", "epochs", {"kind": "network", "changes": {"train.epochs": count}})


def _cells(settings: TrainingSettings, _data: Dataset) -> list[Cell]:
    """A cell for each variant and split; networks are trained once, for the first block of time."""
    made = []
    for number, one in enumerate(_variants(settings)):
        columns = [
            name for name in settings.splits if name == "new" or "objects" not in one.values
        ]  # fewer objects: new ones
        if one.values["kind"] == "network":
            columns = [_ONE_BLOCK]
        values = {"variant": one.name, **one.values}
        made += [Cell(f"{number:03}_{column}", {**values, "column": column}) for column in columns]
    return made


def _run(cell: Cell, settings: TrainingSettings, data: Dataset) -> list[Row]:
    """Errors on all folds of the split, or on the first one."""
    samples = labelled(data)
    folds = make_folds(samples, _SPLITS.get(cell.values["column"], "time"), 0)
    hours = _robot_seconds(samples) / 3600.0
    rows: list[Row] = []
    for fold in folds[:1] if cell.values["column"] == _ONE_BLOCK else folds:
        train, test = fold.sides(samples)
        chosen = _chosen_samples(cell.values, train)
        predicted = _predict(cell.values, settings, data, chosen, test)
        head = {"part": fold.name, "train": len(chosen), "robot_h": len(chosen) * hours}
        mean = labels_of(train).mean(axis=0)
        rows += [{**head, **row} for row in error_rows(test, predicted, labels_of(test), mean)]
    return rows


def _by_object(samples: Sequence[GraspSample]) -> dict[str, list[GraspSample]]:
    """Samples of each object, objects sorted by name."""
    names = sorted({sample.object for sample in samples})
    return {name: [sample for sample in samples if sample.object == name] for name in names}


def _chosen_samples(values: Mapping[str, Any], train: Sequence[GraspSample]) -> list[GraspSample]:
    """The training samples of a variant, drawn at random; all if it has fewer than it asks for. Smaller draws are part of larger ones."""
    groups = _by_object(train)
    if (grasps := values.get("grasps")) is not None:
        orders = {
            name: np.random.default_rng([zlib.crc32(name.encode()), 0]).permutation(len(own))
            for name, own in groups.items()
        }
        return [own[k] for name, own in groups.items() for k in orders[name][: min(grasps, *map(len, groups.values()))]]
    if (count := values.get("objects")) is not None:
        names = list(groups)
        return [one for k in np.random.default_rng(0).permutation(len(names))[:count] for one in groups[names[k]]]
    return list(train)


def _predict(
    values: Mapping[str, Any],
    settings: TrainingSettings,
    data: Dataset,
    train: Sequence[GraspSample],
    test: Sequence[GraspSample],
) -> Float64:
    """(T, 50) predictions of test samples by a variant that is trained on some samples [counts]."""
    if values["kind"] == "mean":
        return np.tile(labels_of(train).mean(axis=0), (len(test), 1))
    if values["kind"] == "network":
        return network("touchnet_v1", 1.0, values["changes"])(train, labels_of(train), test, 0)
    described = describe(data)
    config = ContactTrainingConfig(trees=settings.trees).updated(values.get("changes", {}))
    index = described.index(train)
    thinned = None if config.thinned == 1.0 else described.rows(thinned=True)[index]
    names = [one.object for one in train]
    fitted = fit_contact(described.rows()[index], described.labels[index], names, config, thinned)
    return fitted.predict_rows(described.rows()[described.index(test)])[0]


def _robot_seconds(samples: Sequence[GraspSample]) -> float:
    """Median time from one grasp of an object to the next, as they were recorded; 0 of simulated ones [s]."""
    gaps = np.concatenate([np.diff(sorted(one.stamp_ns for one in own)) for own in _by_object(samples).values()])
    return float(np.median(gaps / 1e9)) if len(gaps) else 0.0


def _tabulate(settings: TrainingSettings, rows: Sequence[Row]) -> list[Row]:
    """A row for each variant: skills, and for each the training grasps and the hours that a robot needs for them."""
    result = []
    for name, own in grouped(rows, "variant"):
        parts = {column: select(own, column=column) for column in (*_SPLITS, _ONE_BLOCK)}
        blocks = [one for one in [*parts["known"], *parts[_ONE_BLOCK]] if one["part"] == _FIRST]
        row: Row = {"variant": name}
        for column, part in {**parts, _ONE_BLOCK: blocks}.items():
            row |= skill_columns(column, part, settings.bootstrap)
        for column, part in parts.items():
            row[f"grasps_{column}"] = round(float(np.mean([one["train"] for one in part]))) if part else None
            row[f"robot_h_{column}"] = float(np.mean([one["robot_h"] for one in part])) if part else None
        result.append(row)
    return result


def _timed(variant: Variant, settings: TrainingSettings, data: Dataset) -> Timed:
    """See `Area.timed`: one fit of a contact model, or one epoch of a network, of the first block of time.

    The features of a contact model are computed before: they cost the same at each setting, about 6 ms a grasp. It also
    predicts some test samples.
    """
    samples = labelled(data)
    (fold,) = (one for one in make_folds(samples, "time", 0) if one.name == _FIRST)
    train, test = fold.sides(samples)
    chosen = _chosen_samples(variant.values, train)
    if variant.values["kind"] != "network":
        return lambda _: _predict(variant.values, settings, data, chosen, test[:_PREDICTED]), 1.0
    from foretouch_lab.learning.data.training_set import TrainingSet
    from foretouch_lab.learning.training.run_config import load_run_config
    from foretouch_lab.learning.training.supervised import SupervisedTrainer

    recipe: Any = load_run_config("touchnet-v1").updated(variant.values["changes"])
    endless = recipe.train.replace(epochs=_ENDLESS)
    trainer = SupervisedTrainer(TrainingSet.build(chosen, recipe.model), np.arange(len(chosen)), endless)
    return lambda _: trainer.run_epoch(), float(recipe.train.epochs)


EXPERIMENT = Area(
    name="tradeoff_training",
    question="What does one more hour buy, of the robot that grasps or of the computer that trains?",
    module=__name__,
    settings=TrainingSettings,
    presets={"small": {"networks": False, "splits": ["known"], "timing_s": 20.0}, "full": {"timing_s": 120.0}},
    prepare=_prepare,
    load=load,
    cells=_cells,
    run=_run,
    tabulate=_tabulate,
    data_folder="vision2tactile",
    variants=_variants,
    timed=_timed,
    skills={
        "known": "mean skill, known objects in blocks of time",
        "new": "mean skill, objects left out",
        _ONE_BLOCK: "mean skill, the first block of time alone",
    },
    panels=(
        Panel("known", 1, "Contact model: skill on known objects (blocks of time)"),
        Panel("new", 1, "Contact model: skill on new objects (left out)"),
        Panel(_ONE_BLOCK, 1, "Networks and contact models: skill on the first block of time"),
    ),
)
