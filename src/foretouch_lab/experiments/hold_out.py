# SPDX-License-Identifier: Apache-2.0
"""Fit each predictor to some grasps and test it on others: one experiment for each way to split.

    cross_validation   P1's five random folds over all objects: neighbours in time are in training and in test
    time_blocked       five consecutive blocks of time within each object
    unseen_object      each object left out once, without a touch and after some touches of it

A fit is tested on all grasps that are held out; after k touches on all that were not touched, in random draws of the
touched ones. The reference of the skill is the mean of the training labels also after touches, so that the skill shows
their effect.
"""

import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np

from foretouch.config import Settings, setting
from foretouch.errors import DatasetError
from foretouch.report.panels import Rows
from foretouch.types import Float64, Sample
from foretouch_lab.experiments.framework.experiment import Cell, Experiment, Row
from foretouch_lab.experiments.shared.figures import Line, draw_series, save_panels
from foretouch_lab.experiments.shared.predictors import NETWORKS, PREDICTORS, contact_predictor
from foretouch_lab.experiments.shared.scores import labelled, score_table
from foretouch_lab.experiments.shared.tables import ALL_OBJECTS, MODEL, select, skill_tables, unique
from foretouch_lab.learning.data import Dataset, labels_of, make_folds
from foretouch_lab.learning.data.folds import Fold, Indices
from foretouch_lab.learning.evaluation.metrics import BootstrapConfig, error_rows

_OBJECT: Final = "object"  # the split that is tested after touches, too
SHRINKAGE: Final = 2.0
"""Variance of a single residual over the variance of the objects' offsets, in touches."""
_CORRECTION: Final = f"after n touches, predictors without adaptation add n / (n + {SHRINKAGE:g}) of their mean residual, as does the mean"


@dataclass(frozen=True, kw_only=True)
class HoldOutSettings(Settings):
    """Settings of all hold-out experiments."""

    predictors: tuple[str, ...] = setting(
        tuple(name for name in PREDICTORS if name not in NETWORKS), "Predictors to compare", choices=tuple(PREDICTORS)
    )
    seeds: tuple[int, ...] = setting(
        (0, 1, 2, 3, 4), "Seeds of splits and predictors; errors are pooled over them", minimum=0
    )
    training_fraction: float = setting(
        1.0, "Fraction of trees and epochs; below 1 only for quick trials", bounds=(0.001, 1.0)
    )
    references: tuple[str, ...] = setting(
        ("geometry_trees",), "Predictors that the others are compared with", choices=tuple(PREDICTORS)
    )
    touches: tuple[int, ...] = setting((0,), "Numbers of touches of the object, for unseen_object", bounds=(0, 1000))
    draws: int = setting(20, "Number of random draws of the touched grasps", bounds=(1, 1000))
    bootstrap: BootstrapConfig = BootstrapConfig()


def _folds(split: str, data: Dataset, seed: int) -> tuple[list[Sample], list[Fold]]:
    samples = labelled(data)
    if not samples:
        raise DatasetError("experiment: no sample is labelled")
    return samples, make_folds(samples, split, seed)


def _cells(split: str, settings: HoldOutSettings, data: Dataset) -> list[Cell]:
    """Return a cell for each seed, predictor and fold; the slow networks run with the first seed only."""
    table = "" if split == _OBJECT else split
    return [
        Cell(
            "+".join(filter(None, (name, table, fold.name, f"seed{seed}"))).replace(" ", "_"),
            {"table": table, "part": fold.name, "predictor": name, "seed": seed},
        )
        for number, seed in enumerate(settings.seeds)
        for _, folds in [_folds(split, data, seed)]
        for name in settings.predictors
        if name not in NETWORKS or number == 0
        for fold in folds
    ]


def _run(split: str, cell: Cell, settings: HoldOutSettings, data: Dataset) -> list[Row]:
    """Fit and test once."""
    samples, folds = _folds(split, data, cell.values["seed"])
    (fold,) = (fold for fold in folds if fold.name == cell.values["part"])
    train, tested = fold.sides(samples)
    labels = labels_of(train)
    name = cell.values["predictor"]
    seed = cell.values["seed"]
    if name == MODEL:
        fitted = contact_predictor(settings.training_fraction, train, labels, seed)
        everything = fitted.predict(tested)
    else:
        everything = PREDICTORS[name](settings.training_fraction)(train, labels, tested, seed)
    actual = labels_of(tested)
    mean = labels.mean(axis=0)
    names = [sample.object for sample in tested]
    if split != _OBJECT:
        return error_rows(names, everything, actual, mean)

    def predict_after(touched: Indices, rest: Indices) -> Float64:
        """Return (R, 50) predictions after touches."""
        if name == MODEL:
            return fitted.predict_after([tested[k] for k in touched], [tested[k] for k in rest])[0]
        return offset_corrected(everything, actual, touched)[rest]

    rows = []
    for count in dict.fromkeys(settings.touches):
        scored, predicted = np.arange(len(tested)), everything
        if count:  # for each draw, the grasps that were not touched
            orders = touch_draws(names[0], len(tested), max(settings.touches), settings.draws)
            draws = [(order[:count], np.sort(order[count:])) for order in orders]
            scored = np.concatenate([rest for _, rest in draws])
            predicted = np.concatenate([predict_after(*draw) for draw in draws])
        errors = error_rows([names[k] for k in scored], predicted, actual[scored], mean)
        rows += [{"table": _table(count), "touches": count, **row} for row in errors]
    return rows


def offset_corrected(predicted: Float64, labels: Float64, touched: Indices) -> Float64:
    """Return (S, D) predictions of grasps on one object with its offset, estimated from n touches of it [counts].

    With residuals r_i = label - prediction of the touched grasps this adds n / (n + a) · mean r_i: the posterior mean of
    the object's offset, where a is `SHRINKAGE`.
    """
    residuals = labels[touched] - predicted[touched]
    return np.asarray(predicted + len(touched) / (len(touched) + SHRINKAGE) * residuals.mean(axis=0), np.float64)


def touch_draws(name: str, count: int, most: int, draws: int) -> list[Indices]:
    """Return for each draw all grasps of an object in the order in which they would be touched.

    The draws follow from the name, the number of grasps and their own number alone: they are the same for every
    predictor, and 3 touches are the first of the 5. Raises `DatasetError` if no grasp would be left after `most`.
    """
    if count <= most:
        raise DatasetError(f"{name}: {count} grasps leave none to score after {most} touches")
    return [np.random.default_rng([zlib.crc32(name.encode()), draw]).permutation(count) for draw in range(draws)]


def _table(count: int) -> str:
    """Return the name of the table after a number of touches."""
    if count == 0:
        return "no touch"
    return f"after {count} {'touch' if count == 1 else 'touches'}"


def _tabulate(split: str, settings: HoldOutSettings, rows: Sequence[Row]) -> list[Row]:
    columns = ("touches",) if split == _OBJECT else ()
    return score_table(rows, settings.predictors, settings.references, settings.bootstrap, columns)


def _draw_touches(rows: Rows, folder: Path) -> list[Path]:
    """Draw `touches.png`: all objects together above, each object below, with the default model if it was run."""
    predictors = unique(rows, "predictor")
    chosen = MODEL if MODEL in predictors else predictors[-1]
    objects = sorted(set(unique(rows, "object")) - {ALL_OBJECTS})
    together = partial(draw_series, x="touches", series="predictor", names=predictors, lowest=-1.0, spread=0.12)
    each = partial(draw_series, x="touches", series="object", names=objects, lowest=-1.0)
    own = [row for row in select(rows, predictor=chosen) if row["object"] != ALL_OBJECTS]
    every, label = select(rows, object=ALL_OBJECTS), "skill, all objects, 95 % interval"
    lines = [
        Line(3.75, every, together, y_label=label, legend="right upper"),
        Line(3.75, own, each, "", "touches of the new object", f"skill, {chosen}, each object", "right lower"),
    ]
    return save_panels(folder / "touches.png", 14.0, lines, sharex=True, sharey="row")


def _experiment(
    name: str, question: str, split: str, presets: Mapping[str, Mapping[str, Any]], **others: Any
) -> Experiment:
    """Make the experiment of one way to split."""
    return Experiment(
        name=name,
        question=question,
        module=__name__,
        presets=presets,
        cells=partial(_cells, split),
        run=partial(_run, split),
        tabulate=partial(_tabulate, split),
        # No cell depends on these; its predictor and seed are among its values.
        resumable_settings=("predictors", "seeds", "references", "bootstrap"),
        data_folder="vision2tactile",
        settings=HoldOutSettings,
        **{"summarise": skill_tables, **others},
    )


_PRESETS: Final[dict[str, dict[str, Any]]] = {
    "full": {"predictors": list(PREDICTORS)},  # hours
    "quick": {},  # all but the networks: minutes
    "smoke": {"seeds": [0], "training_fraction": 0.1},
}
_KNOWN_OBJECTS_ONLY: Final = ("object_mean", "object_time_trees")  # predictors that cannot predict a new object

_NEW_OBJECT: Final = [name for name in PREDICTORS if name not in _KNOWN_OBJECTS_ONLY]
_TOUCHED: Final[dict[str, Any]] = {
    "seeds": [0],
    "references": ["training_mean", "geometry_trees"],
    "touches": [0, 1, 3, 5, 10],
    "predictors": [predictor for predictor in _NEW_OBJECT if predictor not in NETWORKS],
}

EXPERIMENTS: Final = (
    _experiment(
        "cross_validation", "How accurate are predictions for other grasps of the same sessions?", "random", _PRESETS
    ),
    _experiment(
        "time_blocked",
        "How accurate are predictions for earlier or later grasps of the same objects?",
        "time",
        _PRESETS,
    ),
    _experiment(
        "unseen_object",
        "How accurate are predictions on an object that was never touched, and after a few touches of it?",
        "object",
        {
            "full": {**_TOUCHED, "predictors": _NEW_OBJECT},
            "quick": _TOUCHED,
            "smoke": {**_TOUCHED, "training_fraction": 0.1, "draws": 5},
        },
        summarise=partial(skill_tables, notes=[_CORRECTION]),
        figure=_draw_touches,
    ),
)
