# SPDX-License-Identifier: Apache-2.0
"""What does each source of knowledge buy? Each grasp is predicted from what was known before it, in order of time.

The sources are vision, the name of the object, the time, the temperature of the fingers, what the hand has read on other
objects (its history), and touches of this object: alone, and added to each other, without vision and with it.

What predicts the grasps of one run on an object, with or without vision, is fitted to the readings before that run on
other objects; where these are of fewer than two objects, it is their mean. It predicts earlier readings too, each object
by a fit without that object, as the tracker compares readings with predictions. The parameters of the tracker, its slopes
over the temperature among them, are fitted without the object of the run, from earlier and later readings of all others.

The temperature before a grasp is its tare's. Recordings without tares hold the temperature in contact only, which
stands for it; `last temperature` takes the temperature of the grasp before.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import compress
from typing import Any, Final

import numpy as np

from foretouch.config import Settings, setting
from foretouch.types import Float64, Sample
from foretouch_lab.experiments.framework.experiment import Cell, Experiment, Row
from foretouch_lab.experiments.prequential.results import (
    CONSTANT,
    draw_prequential,
    predict_run,
    score_sources,
    summarise_prequential,
    tracker_parameters,
)
from foretouch_lab.experiments.shared.predictors import PREDICTORS
from foretouch_lab.experiments.shared.scores import labelled
from foretouch_lab.experiments.shared.tables import grouped
from foretouch_lab.learning.data import Dataset, labels_of
from foretouch_lab.learning.evaluation.baselines import Baseline
from foretouch_lab.learning.evaluation.metrics import BootstrapConfig
from foretouch_lab.learning.prequential import TimedReadings
from foretouch_lab.learning.training.calibration import rest_level

_SEED: Final = 0
_FEWEST_OBJECTS: Final = 2  # that vision is fitted to


@dataclass(frozen=True, kw_only=True)
class PrequentialSettings(Settings):
    """Settings of `prequential`."""

    predictors: tuple[str, ...] = setting(
        (CONSTANT, "contact"), "Predictors by vision; the training mean is none", choices=tuple(PREDICTORS)
    )
    training_fraction: float = setting(1.0, "Fraction of trees; below 1 only for quick trials", bounds=(0.001, 1.0))
    bootstrap: BootstrapConfig = BootstrapConfig()


def ordered(data: Dataset) -> list[Sample]:
    """Return labelled samples in order of time."""
    return sorted(labelled(data), key=lambda sample: sample.stamp_ns)


def _cells(settings: PrequentialSettings, data: Dataset) -> list[Cell]:
    """Return a cell for each predictor and object."""
    objects = sorted({sample.object for sample in labelled(data)})
    return [
        Cell(f"{predictor}+{name}", {"predictor": predictor, "name": name})
        for predictor in settings.predictors
        for name in objects
    ]


def _run(cell: Cell, settings: PrequentialSettings, data: Dataset) -> list[Row]:
    """Return readings of each run on the object, and predictions from each of the sources, but for the very first run."""
    samples, target = ordered(data), cell.values["name"]
    fit = PREDICTORS[cell.values["predictor"]](settings.training_fraction)
    whole = recording_without(samples, target, fit)
    parameters = tracker_parameters(whole.take(whole.objects != target))
    runs = whole.runs()
    rows = []
    for run in np.unique(runs[whole.objects == target]).tolist():
        row: Row = {"run": run, "runs": int(runs[-1]) + 1, "readings": whole.readings[runs == run].tolist()}
        if run > 0:
            shown = replace(whole.take(runs <= run), expected=expected_before(samples, runs <= run, runs < run, fit))
            predicted = predict_run(shown, *parameters)
            row |= {what: {name: values.tolist() for name, values in own.items()} for what, own in predicted.items()}
        rows.append(row)
    return rows


def recording_without(samples: Sequence[Sample], target: str, fit: Baseline) -> TimedReadings:
    """Return all readings with predictions that know neither the object of the reading nor the target."""
    names, labels = np.array([sample.object for sample in samples]), labels_of(samples)
    expected = np.empty_like(labels)
    for name in np.unique(names):
        expected[names == name] = _predicted(samples, ~np.isin(names, [name, target]), names == name, fit)
    rest, _ = rest_level([sample for sample in samples if sample.object != target])
    return TimedReadings.of_samples(samples, labels, expected, rest).ordered()


def _predicted(samples: Sequence[Sample], train: Any, tested: Any, fit: Baseline) -> Float64:
    """Return (T, 50) predictions of the samples of a mask, by a fit to the samples of another one."""
    known, asked = (list(compress(samples, mask)) for mask in (train, tested))
    return fit(known, labels_of(known), asked, _SEED)


def expected_before(samples: Sequence[Sample], shown: Any, past: Any, fit: Baseline) -> Float64:
    """Return (S, 50) predictions of all grasps up to the end of a run, by fits to other objects before it.

    `shown` and `past` are masks of the samples in order of time: up to the end of the run, and before it.
    """
    names = np.array([sample.object for sample in samples])
    target, count = names[shown][-1], int(shown.sum())
    expected = np.tile(labels_of(list(compress(samples, past))).mean(axis=0), (count, 1))
    for name in np.unique(names[shown]):
        train = past & ~np.isin(names, [name, target])
        if len(np.unique(names[train])) >= _FEWEST_OBJECTS:
            expected[names[shown] == name] = _predicted(samples, train, shown & (names == name), fit)
    return expected


def _tabulate(settings: PrequentialSettings, rows: Sequence[Row]) -> list[Row]:
    return score_sources({name: list(own) for name, own in grouped(rows, "predictor")}, settings.bootstrap)


EXPERIMENT = Experiment(
    name="prequential",
    question="What do vision, name, time, temperature, the hand's history and touches buy a robot at work?",
    module=__name__,
    settings=PrequentialSettings,
    presets={
        "full": {},
        "quick": {"predictors": [CONSTANT]},
        "smoke": {"predictors": [CONSTANT], "bootstrap.draws": 200},
    },
    cells=_cells,
    run=_run,
    tabulate=_tabulate,
    summarise=summarise_prequential,
    figure=draw_prequential,
    resumable_settings=("predictors", "bootstrap"),
    data_folder="vision2tactile",
)
