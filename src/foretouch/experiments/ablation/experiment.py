# SPDX-License-Identifier: Apache-2.0
"""What is each part of the contact model worth, and what are a tare and touches worth to it?

On simulated objects that were never touched, with tares: nothing, a tare, touches, or both to lean on, all scored on the same
grasps. And the model with one part taken out, against the whole: on those objects, and on the real grasps in random
folds, in blocks of time, on objects left out, and after touches of these. A part is taken out by putting the others
together without it (`ablation_parts`): the shipped model has no switches for that.

A model without some features is fitted anew, and only told of before touches: for what it would make of them, its
calibration would have to be made anew as well, at ten to fifteen times the time.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from foretouch.config import setting
from foretouch.experiments.ablation.parts import FULL, REGIME_EDITS, Assembled, assemble
from foretouch.experiments.ablation.table import NOTHING, TARE, ablation_rows, ablation_tables
from foretouch.experiments.framework.experiment import Cell, Experiment, Row
from foretouch.experiments.shared.divisions import divide_objects
from foretouch.experiments.shared.real_grasps import error_rows, labelled
from foretouch.experiments.shared.simulated_data import BothSettings, RealAndSimulated, load_both, prepare_both
from foretouch.experiments.unseen_object.experiment import UnseenObjectSettings, touch_draws
from foretouch.learning.data.folds import Indices, make_folds
from foretouch.learning.data.training_set import labels_of
from foretouch.learning.evaluation.comparison import BootstrapConfig
from foretouch.learning.training.contact import ContactConfig
from foretouch.types import Float64, GraspSample

__all__ = ["EXPERIMENT", "AblationSettings"]

_SIMULATED: Final = "simulated"
_GROUNDS: Final = {
    _SIMULATED: "simulated new objects",
    "random": "real, random folds",
    "time": "real, blocks of time",
    "object": "real, new objects",
}


@dataclass(frozen=True, kw_only=True)
class AblationSettings(BothSettings):
    """Of `ablation`."""

    grounds: tuple[str, ...] = setting(tuple(_GROUNDS), "Where it is asked", choices=tuple(_GROUNDS))
    seeds: tuple[int, ...] = setting((0, 1, 2), "Of the random folds and blocks of time, and of their trees", minimum=0)
    divisions: tuple[int, ...] = setting((0, 1), "Seeds of the divisions of the simulated objects", minimum=0)
    learned: int = setting(65, "Simulated objects to learn from; the others are met", minimum=2)
    touches: tuple[int, ...] = setting((1, 3, 5), "Touches of an object that is met", minimum=1, maximum=1000)
    shown: int = setting(3, "Touches that the parts are compared after", minimum=1, maximum=1000)
    draws: int = setting(10, "How often the touched grasps are drawn", minimum=1, maximum=1000)
    contact: ContactConfig = ContactConfig()
    bootstrap: BootstrapConfig = BootstrapConfig()


def _cells(settings: AblationSettings, data: RealAndSimulated) -> list[Cell]:
    real = labelled(data.real)
    return [
        Cell(f"{ground}+{part}+seed{seed}".replace(" ", "_"), {"ground": ground, "part": part, "seed": seed})
        for ground in settings.grounds
        for part, seed in _parts(ground, real, settings)
    ]


def _parts(ground: str, real: Sequence[GraspSample], settings: AblationSettings) -> Iterator[tuple[str, int]]:
    """Names of divisions or folds, and seeds. Calibrations take time: objects left out are asked with one seed."""
    if ground == _SIMULATED:
        yield from ((str(division), settings.seeds[0]) for division in settings.divisions)
        return
    for seed in settings.seeds if ground != "object" else settings.seeds[:1]:
        yield from ((fold.name, seed) for fold in make_folds(real, ground, seed))


def _run(cell: Cell, settings: AblationSettings, data: RealAndSimulated) -> list[Row]:
    ground, part, seed = (cell.values[key] for key in ("ground", "part", "seed"))
    config = settings.contact.replace(seed=seed)
    if ground == _SIMULATED:
        train, test = divide_objects(labelled(data.simulated), settings.learned, int(part))
    else:
        real = labelled(data.real)
        (fold,) = (one for one in make_folds(real, ground, seed) if one.name == part)
        train, test = ([real[k] for k in side] for side in (fold.train, fold.test))
    models = assemble(train, test, config, calibrated=ground in (_SIMULATED, "object"))
    mean = labels_of(train).mean(axis=0)
    rows = list(_before_touch(f"{_GROUNDS[ground]}, no touch", models, test, mean))
    if ground == "object":
        rows += _after_touches(_GROUNDS[ground], models, test, mean, settings, tare=False)
    if ground == _SIMULATED:
        rows += _after_touches(_GROUNDS[ground], models, test, mean, settings, tare=True)
        rows += _leaning(f"{_GROUNDS[ground]}: what is leaned on", models[FULL], test, mean, settings)
    return rows


def _before_touch(
    table: str, models: dict[str, Assembled], test: Sequence[GraspSample], mean: Float64
) -> Iterator[Row]:
    everyone = np.arange(len(test))
    for name, model in models.items():
        if name in REGIME_EDITS:  # matter after touches alone
            continue
        predicted = model.predict(everyone, everyone[:0], tare=False)
        yield from _told(table, name, test, predicted, mean)


def _after_touches(
    ground: str,
    models: dict[str, Assembled],
    test: Sequence[GraspSample],
    mean: Float64,
    settings: AblationSettings,
    *,
    tare: bool,
) -> Iterator[Row]:
    """Of the variants that were calibrated."""
    table = f"{ground}, {'tare and ' if tare else ''}{settings.shown} touches"
    met = _encounters(test, settings)
    for name, model in models.items():
        if model.trust is not None:
            yield from _met(table, name, model, test, mean, met, settings.shown, tare=tare)


def _leaning(
    table: str, model: Assembled, test: Sequence[GraspSample], mean: Float64, settings: AblationSettings
) -> Iterator[Row]:
    """Of the whole model, with each thing to lean on, on the same grasps."""
    met = _encounters(test, settings)
    for tare in (False, True):
        for count in (0, *settings.touches):
            touched = "" if not count else f"{count} touch{'es' if count > 1 else ''}"
            name = " + ".join(filter(None, (TARE if tare else "", touched))) or NOTHING
            yield from _met(table, name, model, test, mean, met, count, tare=tare)


def _encounters(test: Sequence[GraspSample], settings: AblationSettings) -> list[tuple[Indices, Indices]]:
    """For each object and draw, grasps in the order in which they are touched, and those that are never touched."""
    most = max(*settings.touches, settings.shown)
    how = UnseenObjectSettings(touches=(most,), draws=settings.draws)
    names = np.array([sample.object for sample in test])
    met = []
    for name in np.unique(names):
        mine = np.flatnonzero(names == name)
        met += [(mine[order[:most]], mine[order[most:]]) for order in touch_draws(str(name), len(mine), how)]
    return met


def _met(
    table: str,
    name: str,
    model: Assembled,
    test: Sequence[GraspSample],
    mean: Float64,
    met: Sequence[tuple[Indices, Indices]],
    count: int,
    *,
    tare: bool,
) -> list[Row]:
    predicted = np.concatenate([model.predict(asked, touched[:count], tare=tare) for touched, asked in met])
    scored = [test[k] for _, asked in met for k in asked]
    return _told(table, name, scored, predicted, mean)


def _told(table: str, name: str, scored: Sequence[GraspSample], predicted: Float64, mean: Float64) -> list[Row]:
    return [
        {"table": table, "predictor": name, **row} for row in error_rows(scored, predicted, labels_of(scored), mean)
    ]


def _tabulate(settings: AblationSettings, rows: Sequence[Row]) -> list[Row]:
    return ablation_rows(rows, settings.bootstrap)


EXPERIMENT = Experiment(
    name="ablation",
    question="What is each part of the contact model worth, and what are a tare and touches worth to it?",
    module=__name__,
    settings=AblationSettings,
    presets={
        "full": {},
        "quick": {"contact.trees": 50},
        "smoke": {
            "samples": 100,
            "learned": 50,
            "grounds": ["time"],
            "seeds": [0],
            "draws": 2,
            "contact.trees": 5,
            "bootstrap.draws": 200,
        },
    },
    load=load_both,
    cells=_cells,
    run=_run,
    tabulate=_tabulate,
    summarise=ablation_tables,
    prepare=prepare_both,
    free=("grounds", "seeds", "divisions", "bootstrap"),
    data_folder="vision2tactile",
)
