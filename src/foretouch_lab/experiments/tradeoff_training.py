# SPDX-License-Identifier: Apache-2.0
"""Area `training`: grasps, objects, trees and epochs against the time of a training and of the robot."""

import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from foretouch.config import setting
from foretouch.types import Float64, Sample
from foretouch_lab.experiments.framework.experiment import Row
from foretouch_lab.experiments.framework.tradeoff import Panel, Timed, TradeoffSettings, Variant, make_area
from foretouch_lab.experiments.shared.scores import labelled, skill_rows
from foretouch_lab.experiments.tradeoff_model import described
from foretouch_lab.learning.data import Dataset, labels_of, make_folds
from foretouch_lab.learning.data.folds import Fold
from foretouch_lab.learning.data.training_set import TrainingSet
from foretouch_lab.learning.evaluation.metrics import error_rows
from foretouch_lab.learning.training.contact import ContactTrainingConfig
from foretouch_lab.learning.training.learners import make_learner
from foretouch_lab.learning.training.run_config import load_run_config
from foretouch_lab.learning.training.supervised import SupervisedTrainer

# Folds of each skill; of the last one, the first fold alone.
_SPLITS: Final = {"known": "time", "new": "object", "one_block": "time"}
_NETWORK: Final = "touchnet-v1"
_PREDICTED: Final = 10  # test samples that a fit predicts, when it is timed


def _variants() -> Iterator[Variant]:
    """Iterate over the variants; the shipped models use all grasps (40 of 50 in a block of time) and objects."""
    yield Variant("contact model as shipped", "shipped")
    yield Variant("mean of labels", "part", {"mean": True})
    for count in (5, 10, 20):
        yield Variant(f"{count} grasps an object", "labels", {"grasps": count})
    for count in (2, 4):
        yield Variant(f"{count} objects", "objects", {"objects": count})
    for count in (5, 15, 120):
        yield Variant(f"{count} trees", "trees", {"trees": count})
    yield Variant("no thinned copies", "copies", {"thinned": 1.0})
    yield Variant("network as shipped", "shipped", {"epochs": 120})
    for count in (10, 30, 60, 240):
        yield Variant(f"network, {count} epochs", "epochs", {"epochs": count})


VARIANTS: Final = tuple(_variants())


@dataclass(frozen=True, kw_only=True)
class TrainingSettings(TradeoffSettings):
    """Settings of the area."""

    trees: int = setting(60, "Trees of each forest of the contact model", bounds=(1, 1000))


def _accuracy(skill: str, settings: TrainingSettings, data: Dataset) -> dict[str, Row]:
    """Return errors on all folds, or for networks, which take a minute a fold, on the first one.

    `robot_h_<skill>` are the hours that a robot needs for the training grasps.
    """
    samples = labelled(data)
    errors: dict[str, list[Row]] = {}
    counts: dict[str, list[int]] = {}
    folds = make_folds(samples, _SPLITS[skill], 0)[: 1 if skill == "one_block" else None]
    for variant in VARIANTS:
        if ("epochs" in variant.values and skill != "one_block") or ("objects" in variant.values and skill != "new"):
            continue
        for fold in folds:
            train, test = fold.sides(samples)
            chosen = _chosen(variant.values, train)
            counts.setdefault(variant.name, []).append(len(chosen))
            predicted = _predict(variant.values, settings, data, chosen, test)
            names, mean = [sample.object for sample in test], labels_of(train).mean(axis=0)
            errors.setdefault(variant.name, []).extend(error_rows(names, predicted, labels_of(test), mean))
    hours = _robot_seconds(samples) / 3600.0
    scored = skill_rows(skill, errors, settings.bootstrap)
    return {name: row | {f"robot_h_{skill}": hours * float(np.mean(counts[name]))} for name, row in scored.items()}


def _by_object(samples: Sequence[Sample]) -> dict[str, list[Sample]]:
    """Return samples of each object, objects sorted by name."""
    names = sorted({sample.object for sample in samples})
    return {name: [sample for sample in samples if sample.object == name] for name in names}


def _robot_seconds(samples: Sequence[Sample]) -> float:
    """Return the median time from one grasp of an object to the next, as they were recorded [s]."""
    gaps = [np.diff(sorted(sample.stamp_ns for sample in own)) for own in _by_object(samples).values()]
    return float(np.median(np.concatenate(gaps))) / 1e9


def _chosen(values: Mapping[str, Any], train: Sequence[Sample]) -> list[Sample]:
    """Return the training samples of a variant, drawn at random; smaller draws are part of larger ones."""
    groups = _by_object(train)
    if "objects" in values:
        names = np.random.default_rng(0).permutation(list(groups))[: values["objects"]]
        return [sample for name in names for sample in groups[name]]
    if "grasps" in values:
        most = min(values["grasps"], *map(len, groups.values()))
        seeds = {name: [zlib.crc32(name.encode()), 0] for name in groups}
        return [
            own[k]
            for name, own in groups.items()
            for k in np.random.default_rng(seeds[name]).permutation(len(own))[:most]
        ]
    return list(train)


def _predict(
    values: Mapping[str, Any],
    settings: TrainingSettings,
    data: Dataset,
    train: Sequence[Sample],
    test: Sequence[Sample],
) -> Float64:
    """Return (T, 50) predictions of test samples by a variant that is trained on some samples [counts]."""
    if "mean" in values:
        return np.tile(labels_of(train).mean(axis=0), (len(test), 1))
    predictor, place = described(data)
    known, asked = (np.array([place[sample.id] for sample in side]) for side in (train, test))
    if "epochs" in values:
        recipe = load_run_config(_NETWORK, ["calibrate=true", f"train.epochs={values['epochs']}"])
        return make_learner(recipe, data).predict_fold(Fold(known, asked))
    changes = {name: values[name] for name in ("trees", "thinned") if name in values}
    config = ContactTrainingConfig(trees=settings.trees).updated(changes)
    return predictor.fit(known, config).predict_rows(predictor.rows[asked])[0]


def _timed(variant: Variant, settings: TrainingSettings, data: Dataset) -> Timed:
    """Return one fit of a contact model, or one epoch of a network, of the first block of time.

    The features of a contact model are computed before: they cost the same at each setting, about 6 ms a grasp. It also
    predicts some test samples.
    """
    samples = labelled(data)
    train, test = make_folds(samples, "time", 0)[0].sides(samples)
    chosen = _chosen(variant.values, train)
    if "epochs" not in variant.values:
        return lambda _: _predict(variant.values, settings, data, chosen, test[:_PREDICTED]), 1.0
    recipe = load_run_config(_NETWORK, ["train.epochs=100000"])  # as many as are timed
    trainer = SupervisedTrainer(TrainingSet.build(chosen, recipe.model), np.arange(len(chosen)), recipe.train)
    return lambda _: trainer.run_epoch(), float(variant.values["epochs"])


EXPERIMENT = make_area(
    _accuracy,
    name="tradeoff_training",
    question="What does one more hour buy, of the robot that grasps or of the computer that trains?",
    module=__name__,
    settings=TrainingSettings,
    presets={
        "smoke": {"skills": ["known"], "trees": 2, "timing_s": 2.0},
        "small": {"skills": ["known"], "timing_s": 20.0},
        "full": {"timing_s": 120.0},
    },
    data_folder="vision2tactile",
    variants=VARIANTS,
    timed=_timed,
    panels=(
        Panel("known", 1, "Contact model: skill on known objects (blocks of time)"),
        Panel("new", 1, "Contact model: skill on new objects (left out)"),
        Panel("one_block", 1, "Networks and contact models: skill on the first block of time"),
    ),
)
