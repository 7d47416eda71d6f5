# SPDX-License-Identifier: Apache-2.0
"""How much do the components of the contact model contribute, and how much a tare and touches?

On simulated objects that were never touched, with tares: predictions without adaptation, with a tare, after touches, and with
both, all scored on the same grasps. And the model without one of its components, compared with the full one: on those
objects, and on the real grasps in random folds, in blocks of time, on objects left out, and after touches of these.

A model with other features is fitted anew and only tested before touches, since a new calibration for it would take
ten to fifteen times as long.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from foretouch.config import setting
from foretouch.experiments.ablation.results import (
    NOTHING,
    TARE,
    TARES_AND_TOUCHES,
    ablation_rows,
    ablation_tables,
    draw_ablation_figure,
)
from foretouch.experiments.ablation.variants import FULL, GROUP_EDITS, ModelVariant, fit_variants
from foretouch.experiments.framework.experiment import Cell, Experiment, Row
from foretouch.experiments.shared.folds import split_by_fold, split_objects
from foretouch.experiments.shared.real_grasps import error_rows, labelled
from foretouch.experiments.shared.simulated_data import BothSettings, RealAndSimulated, load_both, prepare_both
from foretouch.experiments.unseen_object import UnseenObjectSettings, touch_draws
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
    """Settings of `ablation`."""

    grounds: tuple[str, ...] = setting(tuple(_GROUNDS), "Data and splits to test on", choices=tuple(_GROUNDS))
    seeds: tuple[int, ...] = setting(
        (0, 1, 2), "Seeds of the random folds, of the blocks of time and of their trees", minimum=0
    )
    divisions: tuple[int, ...] = setting((0, 1), "Seeds of the splits of the simulated objects", minimum=0)
    learned: int = setting(65, "Simulated training objects; the others are tested", minimum=2)
    touches: tuple[int, ...] = setting((1, 3, 5), "Numbers of touches of a test object", minimum=1, maximum=1000)
    shown: int = setting(3, "Number of touches after which the variants are compared", minimum=1, maximum=1000)
    draws: int = setting(10, "Number of random draws of the touched grasps", minimum=1, maximum=1000)
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
    """Names of splits or folds, and seeds. Since calibration is slow, objects are left out with one seed only."""
    if ground == _SIMULATED:
        yield from ((str(split), settings.seeds[0]) for split in settings.divisions)
        return
    for seed in settings.seeds if ground != "object" else settings.seeds[:1]:
        yield from ((fold.name, seed) for fold in make_folds(real, ground, seed))


def _run(cell: Cell, settings: AblationSettings, data: RealAndSimulated) -> list[Row]:
    ground, part, seed = (cell.values[key] for key in ("ground", "part", "seed"))
    config = settings.contact.replace(seed=seed)
    if ground == _SIMULATED:
        train, test = split_objects(labelled(data.simulated), settings.learned, int(part))
    else:
        real = labelled(data.real)
        train, test = split_by_fold(real, make_folds(real, ground, seed), part)
    models = fit_variants(train, test, config, calibrated=ground in (_SIMULATED, "object"))
    mean = labels_of(train).mean(axis=0)
    rows = list(_before_touch(f"{_GROUNDS[ground]}, no touch", models, test, mean))
    if ground == "object":
        rows += _after_touches(_GROUNDS[ground], models, test, mean, settings, tare=False)
    if ground == _SIMULATED:
        rows += _after_touches(_GROUNDS[ground], models, test, mean, settings, tare=True)
        rows += _full_after_touches(f"{_GROUNDS[ground]}{TARES_AND_TOUCHES}", models[FULL], test, mean, settings)
    return rows


def _before_touch(
    table: str, models: dict[str, ModelVariant], test: Sequence[GraspSample], mean: Float64
) -> Iterator[Row]:
    every = np.arange(len(test))
    for name, model in models.items():
        if name in GROUP_EDITS:  # these only matter after touches
            continue
        predicted = model.predict(every, every[:0], tare=False)
        yield from _rows(table, name, test, predicted, mean)


def _after_touches(
    ground: str,
    models: dict[str, ModelVariant],
    test: Sequence[GraspSample],
    mean: Float64,
    settings: AblationSettings,
    *,
    tare: bool,
) -> Iterator[Row]:
    """Rows of the calibrated variants."""
    table = f"{ground}, {'tare and ' if tare else ''}{settings.shown} touches"
    draws = _touch_draws(test, settings)
    for name, model in models.items():
        if model.calibration is not None:
            yield from _touched_rows(table, name, model, test, mean, draws, settings.shown, tare=tare)


def _full_after_touches(
    table: str, model: ModelVariant, test: Sequence[GraspSample], mean: Float64, settings: AblationSettings
) -> Iterator[Row]:
    """Rows of the full model with and without tare, after each number of touches, on the same grasps."""
    draws = _touch_draws(test, settings)
    for tare in (False, True):
        for count in (0, *settings.touches):
            touches = "" if not count else f"{count} touch{'es' if count > 1 else ''}"
            name = " + ".join(filter(None, (TARE if tare else "", touches))) or NOTHING
            yield from _touched_rows(table, name, model, test, mean, draws, count, tare=tare)


def _touch_draws(test: Sequence[GraspSample], settings: AblationSettings) -> list[tuple[Indices, Indices]]:
    """For each object and draw, grasps in the order in which they are touched, and those that are scored."""
    most = max(*settings.touches, settings.shown)
    how = UnseenObjectSettings(touches=(most,), draws=settings.draws)
    names = np.array([sample.object for sample in test])
    draws = []
    for name in np.unique(names):
        mine = np.flatnonzero(names == name)
        draws += [(mine[order[:most]], mine[order[most:]]) for order in touch_draws(str(name), len(mine), how)]
    return draws


def _touched_rows(
    table: str,
    name: str,
    model: ModelVariant,
    test: Sequence[GraspSample],
    mean: Float64,
    draws: Sequence[tuple[Indices, Indices]],
    count: int,
    *,
    tare: bool,
) -> list[Row]:
    predicted = np.concatenate([model.predict(index, touched[:count], tare=tare) for touched, index in draws])
    scored = [test[k] for _, index in draws for k in index]
    return _rows(table, name, scored, predicted, mean)


def _rows(table: str, name: str, scored: Sequence[GraspSample], predicted: Float64, mean: Float64) -> list[Row]:
    return [
        {"table": table, "predictor": name, **row} for row in error_rows(scored, predicted, labels_of(scored), mean)
    ]


def _tabulate(settings: AblationSettings, rows: Sequence[Row]) -> list[Row]:
    return ablation_rows(rows, settings.bootstrap)


EXPERIMENT = Experiment(
    name="ablation",
    question="How much do the components of the contact model contribute, and how much a tare and touches?",
    module=__name__,
    order=90,
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
    figure=draw_ablation_figure,
    prepare=prepare_both,
    free=("grounds", "seeds", "divisions", "bootstrap"),
    data_folder="vision2tactile",
)
