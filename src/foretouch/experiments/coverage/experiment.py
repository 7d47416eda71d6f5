# SPDX-License-Identifier: Apache-2.0
"""Do the 90 % intervals of the contact model hold 90 % of what is read on objects that it never touched?

    simulated     some of a scene's objects are learned from and calibrated on, the others are met; several divisions
    left out      each real object once: neither the fit nor the calibration has seen it
    time blocks   the known real objects at a time that neither the fit nor the calibration has seen

An object is met without a touch and after some, with a tare and without one where there are tares. What is asked is the
predictor that ships: `ContactPredictor`, whose calibration is made of the training side alone.

Coverage is counted value by value and averaged over the values of a modality, the grasps and the draws of touches. Width is
told against the interval of one who knows nothing but the mean of the training labels, calibrated by the same rule.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from foretouch.config import setting
from foretouch.experiments.coverage.table import SIMULATED, coverage_table, coverage_tables
from foretouch.experiments.framework.experiment import Cell, Experiment, Row
from foretouch.experiments.shared.divisions import by_object, divide_objects
from foretouch.experiments.shared.real_grasps import labelled
from foretouch.experiments.shared.simulated_data import (
    BothSettings,
    RealAndSimulated,
    load_both,
    prepare_both,
)
from foretouch.experiments.unseen_object.experiment import UnseenObjectSettings, touch_draws
from foretouch.learning.data.folds import make_folds
from foretouch.learning.data.training_set import labels_of
from foretouch.learning.evaluation.comparison import BootstrapConfig
from foretouch.learning.training.calibration import HeldOutPredictions, fit_group
from foretouch.learning.training.contact import ContactConfig, object_folds
from foretouch.learning.training.contact_predictor import ContactPredictor
from foretouch.tactile.modalities import MODALITIES, columns
from foretouch.types import Float64, GraspSample

__all__ = ["EXPERIMENT", "CoverageSettings", "coverage_rows"]

_LEFT_OUT: Final = "left out"
_TIME: Final = "time blocks"
_SPLITS: Final = {_LEFT_OUT: "object", _TIME: "time"}


@dataclass(frozen=True, kw_only=True)
class CoverageSettings(BothSettings):
    """Of `coverage`."""

    grounds: tuple[str, ...] = setting(
        (SIMULATED, _LEFT_OUT, _TIME), "Where it is asked", choices=(SIMULATED, _LEFT_OUT, _TIME)
    )
    divisions: tuple[int, ...] = setting((0, 1, 2), "Seeds of the divisions of the simulated objects", minimum=0)
    learned: int = setting(65, "Simulated objects to learn from; the others are met", minimum=2)
    touches: tuple[int, ...] = setting((0, 1, 3, 5), "Touches of an object that is met", minimum=0, maximum=1000)
    draws: int = setting(10, "How often the touched grasps are drawn", minimum=1, maximum=1000)
    contact: ContactConfig = ContactConfig()
    bootstrap: BootstrapConfig = BootstrapConfig()


def _cells(settings: CoverageSettings, data: RealAndSimulated) -> list[Cell]:
    cells = []
    for ground in settings.grounds:
        if ground == SIMULATED:
            parts = [str(seed) for seed in settings.divisions]
        else:
            parts = [fold.name for fold in make_folds(labelled(data.real), _SPLITS[ground], 0)]
        cells += [Cell(f"{ground}+{part}".replace(" ", "_"), {"ground": ground, "part": part}) for part in parts]
    return cells


def _run(cell: Cell, settings: CoverageSettings, data: RealAndSimulated) -> list[Row]:
    ground, part = cell.values["ground"], cell.values["part"]
    touches = settings.touches
    if ground == SIMULATED:
        train, test = divide_objects(labelled(data.simulated), settings.learned, int(part))
    else:
        real = labelled(data.real)
        (fold,) = (f for f in make_folds(real, _SPLITS[ground], 0) if f.name == part)
        train, test = ([real[k] for k in side] for side in (fold.train, fold.test))
    if ground == _TIME:
        touches = (0,)
    fitted = ContactPredictor(train, labels_of(train), settings.contact)
    naive = _naive_half_width(train)
    how = UnseenObjectSettings(touches=touches, draws=settings.draws)
    tares = (False, True) if all(sample.tare is not None for sample in test) else (False,)
    return [
        row for held in by_object(test) for tare in tares for row in coverage_rows(fitted, held, naive, how, tare=tare)
    ]


def _naive_half_width(train: Sequence[GraspSample]) -> Float64:
    """(50,) half width of the interval round the mean of the training labels, calibrated on objects left out [counts]."""
    labels, objects = labels_of(train), np.array([sample.object for sample in train])
    predicted = np.empty_like(labels)
    for fold in object_folds(list(objects)):
        predicted[fold.test] = labels[fold.train].mean(axis=0)
    return fit_group(HeldOutPredictions(predicted, labels, objects, objects)).half_width


def coverage_rows(
    fitted: ContactPredictor, held: Sequence[GraspSample], naive: Float64, how: UnseenObjectSettings, *, tare: bool
) -> list[Row]:
    """How much of what is read on one object its intervals hold: one row for each number of touches.

    Args:
        fitted: Was neither fitted to nor calibrated on these grasps.
        held: All grasps of the object.
        naive: (50,) half width that widths are told against [counts].
        how: How many touches, in how many draws.
        tare: Whether to lean on the tares.

    Returns:
        `coverage` and `width`, four numbers each, by modality; `unfamiliar`, the share of grasps that are flagged.
    """
    unfamiliar = float(np.mean(~fitted.familiar(held)))
    rows = []
    for count in how.touches:
        inside, widths = [], []
        orders = touch_draws(held[0].object, len(held), how) if count else [np.arange(len(held))]
        for order in orders:
            touched, rest = ([held[k] for k in side] for side in (order[:count], order[count:]))
            counts, half = fitted.intervals_after(touched, rest, tare=tare)
            inside.append((np.abs(labels_of(rest) - counts) <= half).mean(axis=0))
            widths.append((half / naive).mean(axis=0))
        rows.append(
            {
                "object": held[0].object,
                "tare": tare,
                "touches": count,
                "grasps": len(held) - count,
                "coverage": _by_modality(np.mean(inside, axis=0)),
                "width": _by_modality(np.mean(widths, axis=0)),
                "unfamiliar": unfamiliar,
            }
        )
    return rows


def _by_modality(values: Float64) -> list[float]:
    return [float(values[columns([name])].mean()) for name in MODALITIES]


def _tabulate(settings: CoverageSettings, rows: Sequence[Row]) -> list[Row]:
    return coverage_table(rows, settings.bootstrap)


EXPERIMENT = Experiment(
    name="coverage",
    question="Do the 90 % intervals hold 90 % of what is read on objects that were never touched?",
    module=__name__,
    settings=CoverageSettings,
    presets={
        "full": {},
        "quick": {"contact.trees": 50},
        "smoke": {
            "samples": 100,
            "learned": 50,
            "grounds": [SIMULATED],
            "divisions": [0],
            "touches": [0],
            "contact.trees": 5,
            "bootstrap.draws": 200,
        },
    },
    load=load_both,
    cells=_cells,
    run=_run,
    tabulate=_tabulate,
    summarise=coverage_tables,
    prepare=prepare_both,
    free=("grounds", "divisions", "bootstrap"),
    data_folder="vision2tactile",
)
