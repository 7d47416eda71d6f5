# SPDX-License-Identifier: Apache-2.0
"""Predict each real grasp from vision and all that was read before it, of whatever object, in order of time.

This is what a robot at work does. The predictor of an object by vision is fitted to the other objects, earlier and later
ones; the parameters of the tracker are fitted without the object too, from predictions of the others by models that
know neither them nor the object (a fit for each pair). `past_mean` stands for a vision that predicts the mean of all
readings before the object was taken, so that nothing later enters but the parameters.

Where tares were recorded, the tracker reads each before the prediction of its grasp, as a difference from the mean of
those of the other objects; and it is scored once more without them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any, Final

import numpy as np

from foretouch.config import Settings, setting
from foretouch.experiments.framework.experiment import Cell, Experiment, Row
from foretouch.experiments.prequential.results import draw_prequential, prequential_rows, summarise_prequential
from foretouch.experiments.shared.predictors import PREDICTORS, find_predictor
from foretouch.experiments.shared.scores import labelled, load
from foretouch.experiments.shared.tables import grouped
from foretouch.learning.data import Dataset, labels_of
from foretouch.learning.evaluation.metrics import BootstrapConfig
from foretouch.learning.evaluation.prequential import Recording
from foretouch.learning.training.calibration import rest_level

__all__ = ["EXPERIMENT", "PrequentialSettings"]

_MEAN: Final = "training_mean"
_SEED: Final = 0


@dataclass(frozen=True, kw_only=True)
class PrequentialSettings(Settings):
    """Settings of `prequential`."""

    predictors: tuple[str, ...] = setting(
        ("contact", _MEAN), "Predictors by vision whose errors are tracked", choices=tuple(PREDICTORS)
    )
    training_fraction: float = setting(
        1.0, "Fraction of trees and epochs; below 1 only for quick trials", minimum=0.001, maximum=1.0
    )
    bootstrap: BootstrapConfig = BootstrapConfig()


def _cells(settings: PrequentialSettings, data: Dataset) -> list[Cell]:
    """A fit without each object, and without each pair."""
    objects = sorted({sample.object for sample in labelled(data)})
    without = [(name,) for name in objects] + list(combinations(objects, 2))
    return [
        Cell(f"{predictor}+{'-'.join(names)}", {"predictor": predictor, "without": list(names)})
        for predictor in settings.predictors
        for names in without
    ]


def _run(cell: Cell, settings: PrequentialSettings, data: Dataset) -> list[Row]:
    """Predictions of the objects that the fit is without, with stamps and readings where it is without one only."""
    without = cell.values["without"]
    samples = labelled(data)
    train = [sample for sample in samples if sample.object not in without]
    fitted = find_predictor(cell.values["predictor"], settings.training_fraction)(train, labels_of(train), _SEED)
    rest, _ = rest_level(train)
    rows: list[Row] = []
    for name in without:
        own = [sample for sample in samples if sample.object == name]
        row: Row = {"object": name, "expected": fitted.predict(own).tolist()}
        if len(without) == 1:
            row |= {"stamps_ns": [sample.stamp_ns for sample in own], "readings": labels_of(own).tolist()}
            row["tares"] = [None if sample.tare is None else (sample.tare.vector() - rest).tolist() for sample in own]
        rows.append(row)
    return rows


def _tabulate(settings: PrequentialSettings, rows: Sequence[Row]) -> list[Row]:
    result: list[Row] = []
    for predictor, own in grouped(rows, "predictor"):
        recordings = _recordings(own)
        past = predictor == _MEAN
        if any(recording.tares is not None for recording in recordings.values()):
            result += prequential_rows(f"{predictor}, with tares", recordings, settings.bootstrap)
            recordings = {name: replace(recording, tares=None) for name, recording in recordings.items()}
        if recordings:
            result += prequential_rows(predictor, recordings, settings.bootstrap, past=past)
    return result


def _recordings(rows: Sequence[Row]) -> dict[str, Recording]:
    """For each object, all readings with predictions that know neither the object of the reading nor this one.

    Nothing if a cell is missing.
    """
    found = {(tuple(row["without"]), row["object"]): row for row in rows}
    objects = sorted({row["object"] for row in rows})
    recordings = {}
    for target in objects:
        parts: list[dict[str, Any]] = []
        for name in objects:
            whole = found.get(((name,), name))
            row = whole if name == target else found.get((tuple(sorted((name, target))), name))
            if whole is None or row is None:
                return {}
            parts.append({"name": name, **whole, "expected": row["expected"]})
        names = np.concatenate([np.full(len(part["stamps_ns"]), part["name"]) for part in parts]).astype(np.str_)
        stamps, readings, expected = (
            np.concatenate([np.array(part[key]) for part in parts]) for key in ("stamps_ns", "readings", "expected")
        )
        unknown = np.full(readings.shape[1], np.nan)
        tares = np.array([unknown if tare is None else tare for part in parts for tare in part["tares"]])
        known = None if np.isnan(tares).all() else tares
        recordings[target] = Recording(stamps, names, readings, expected, known).ordered()
    return recordings


EXPERIMENT = Experiment(
    name="prequential",
    question="How accurate are predictions of a robot at work, which remembers all that it has read?",
    module=__name__,
    order=5,
    settings=PrequentialSettings,
    presets={"full": {}, "quick": {"predictors": [_MEAN]}, "smoke": {"predictors": [_MEAN], "bootstrap.draws": 200}},
    load=load,
    cells=_cells,
    run=_run,
    tabulate=_tabulate,
    summarise=summarise_prequential,
    figure=draw_prequential,
    resumable_settings=("predictors", "bootstrap"),
    data_folder="vision2tactile",
)
