# SPDX-License-Identifier: Apache-2.0
"""Do the 90 % intervals of the contact model cover 90 % of the readings on objects that were never touched?

    simulated      some objects of a scene for training and calibration, the others for testing; several random splits
    left out       each real object left out once, of training and of calibration
    time blocks    known real objects, at a time that is left out of training and of calibration

An object is tested without a touch and after some, with a tare and without where there are tares. The predictor is the
released one, `ContactPredictor`, which is calibrated on its training samples alone.

Coverage is counted value by value and averaged over the values of a modality, the grasps and the draws of touches.
Width is relative to the interval around the mean of the training labels, calibrated by the same rule.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from foretouch.config import setting
from foretouch.experiments.coverage.results import SIMULATED, coverage_table, coverage_tables, draw_coverage_figure
from foretouch.experiments.framework.experiment import Cell, Experiment, Row
from foretouch.experiments.shared.conditions import ConditionSettings, split_condition
from foretouch.experiments.shared.folds import by_object, touch_draws
from foretouch.experiments.shared.scores import labelled
from foretouch.experiments.shared.simulated_data import RealAndSimulated, load_both, prepare_both
from foretouch.learning.data import labels_of, make_folds, object_folds
from foretouch.learning.training.calibration import HeldOutPredictions, fit_group
from foretouch.learning.training.contact import ContactPredictor
from foretouch.tactile import MODALITIES, columns
from foretouch.types import Float64, GraspSample

__all__ = ["EXPERIMENT", "CoverageSettings", "coverage_rows"]

_TIME: Final = "time blocks"
_SPLITS: Final = {SIMULATED: "", "left out": "object", _TIME: "time"}


@dataclass(frozen=True, kw_only=True)
class CoverageSettings(ConditionSettings):
    """Settings of `coverage`."""

    test_conditions: tuple[str, ...] = setting(tuple(_SPLITS), "Data and splits to test on", choices=tuple(_SPLITS))
    touches: tuple[int, ...] = setting((0, 1, 3, 5), "Numbers of touches of a test object", minimum=0, maximum=1000)


def _cells(settings: CoverageSettings, data: RealAndSimulated) -> list[Cell]:
    cells = []
    for condition in settings.test_conditions:
        if condition == SIMULATED:
            parts = [str(seed) for seed in settings.split_seeds]
        else:
            parts = [fold.name for fold in make_folds(labelled(data.real), _SPLITS[condition], 0)]
        cells += [Cell(f"{condition}+{one}".replace(" ", "_"), {"condition": condition, "part": one}) for one in parts]
    return cells


def _run(cell: Cell, settings: CoverageSettings, data: RealAndSimulated) -> list[Row]:
    condition = cell.values["condition"]
    train, test = split_condition(settings, data, _SPLITS[condition], cell.values["part"])
    fitted = ContactPredictor(train, labels_of(train), settings.contact)
    reference = _reference_half_width(train)
    touches = (0,) if condition == _TIME else settings.touches
    tares = (False, True) if all(sample.tare is not None for sample in test) else (False,)
    return [
        row
        for samples in by_object(test)
        for tare in tares
        for row in coverage_rows(fitted, samples, reference, touches, settings.draws, tare=tare)
    ]


def _reference_half_width(train: Sequence[GraspSample]) -> Float64:
    """(50,) half width around the mean of the training labels, calibrated on held-out objects [counts]."""
    labels, objects = labels_of(train), np.array([sample.object for sample in train])
    predicted = np.empty_like(labels)
    for fold in object_folds(list(objects)):
        predicted[fold.test] = labels[fold.train].mean(axis=0)
    return fit_group(HeldOutPredictions(predicted, labels, objects, objects)).half_width


def coverage_rows(
    fitted: ContactPredictor,
    samples: Sequence[GraspSample],
    reference: Float64,
    touches: Sequence[int],
    draws: int,
    *,
    tare: bool,
) -> list[Row]:
    """Coverage of the intervals on one object, a row for each number of touches.

    Args:
        fitted: Predictor that was neither fitted to nor calibrated on these grasps.
        samples: All grasps of the object.
        reference: (50,) half width that widths are divided by [counts].
        touches: Numbers of touches.
        draws: Number of random draws of the touched grasps.
        tare: Whether the predictor adapts to the tares.

    Returns:
        `coverage` and `width`, four numbers each, by modality; `unfamiliar`, the share of grasps flagged as such.
    """
    unfamiliar = float(np.mean(~fitted.familiar(samples)))
    rows = []
    for count in touches:
        inside, widths = [], []
        every = [np.arange(len(samples))]
        for order in touch_draws(samples[0].object, len(samples), max(touches), draws) if count else every:
            touched, rest = ([samples[k] for k in side] for side in (order[:count], order[count:]))
            counts, half = fitted.intervals_after(touched, rest, tare=tare)
            inside.append((np.abs(labels_of(rest) - counts) <= half).mean(axis=0))
            widths.append((half / reference).mean(axis=0))
        head = {"object": samples[0].object, "tare": tare, "touches": count, "grasps": len(samples) - count}
        shares = {"coverage": _by_modality(inside), "width": _by_modality(widths), "unfamiliar": unfamiliar}
        rows.append({**head, **shares})
    return rows


def _by_modality(draws: Sequence[Float64]) -> list[float]:
    values = np.mean(draws, axis=0)
    return [float(values[columns([name])].mean()) for name in MODALITIES]


EXPERIMENT = Experiment(
    name="coverage",
    question="Do the 90 % intervals cover 90 % of the readings on objects that were never touched?",
    module=__name__,
    order=80,
    settings=CoverageSettings,
    presets={
        "full": {},
        "quick": {"contact.trees": 50},
        "smoke": {
            "samples": 100,
            "train_objects": 50,
            "test_conditions": [SIMULATED],
            "split_seeds": [0],
            "touches": [0],
            "contact.trees": 5,
            "bootstrap.draws": 200,
        },
    },
    load=load_both,
    cells=_cells,
    run=_run,
    tabulate=lambda settings, rows: coverage_table(rows, settings.bootstrap),
    summarise=coverage_tables,
    figure=draw_coverage_figure,
    prepare=prepare_both,
    resumable_settings=("test_conditions", "split_seeds", "bootstrap"),
    data_folder="vision2tactile",
)
