# SPDX-License-Identifier: Apache-2.0
"""What does each source of knowledge buy? Each grasp is predicted from what was known before it, in order of time.

The sources are vision, the name of the object, the time, the temperature of the fingers, what the hand has read on other
objects (its history), and touches of this object: alone, and added to each other, without vision and with it.

What predicts the grasps of one run on an object, with or without vision, is fitted to the readings before that run on
other objects; where these are of fewer than two objects, it is their mean. It predicts earlier readings too, each object
by a fit without that object, as the tracker compares readings with predictions. The parameters of the tracker, its slopes
over the temperature among them, are fitted without the object of the run, from earlier and later readings of all others.

The temperature before a grasp is that of its tare. Recordings without tares hold the temperature in contact only, which
stands for it; `last temperature` takes that of the grasp before.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from foretouch.config import Settings, setting
from foretouch.types import Float64, GraspSample
from foretouch_lab.experiments.framework.experiment import Cell, Experiment, Row
from foretouch_lab.experiments.prequential.results import (
    CONSTANT,
    draw_prequential,
    prequential_rows,
    summarise_prequential,
)
from foretouch_lab.experiments.shared.predictors import PREDICTORS, find_predictor
from foretouch_lab.experiments.shared.scores import labelled, load
from foretouch_lab.experiments.shared.tables import grouped
from foretouch_lab.learning.data import Dataset, labels_of
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
    training_fraction: float = setting(
        1.0, "Fraction of trees and epochs; below 1 only for quick trials", bounds=(0.001, 1.0)
    )
    bootstrap: BootstrapConfig = BootstrapConfig()


def _ordered(data: Dataset) -> tuple[list[GraspSample], npt.NDArray[np.int_]]:
    """Labelled samples in order of time, and the run of each (see `TimedReadings.runs`)."""
    samples = sorted(labelled(data), key=lambda sample: sample.stamp_ns)
    labels = labels_of(samples)
    return samples, TimedReadings.of_samples(samples, labels, labels, labels[0]).ordered().runs()


def _cells(settings: PrequentialSettings, data: Dataset) -> list[Cell]:
    """A fit without each object and without each pair, and the fits before each run of grasps on an object but the first."""
    samples, runs = _ordered(data)
    objects = sorted({sample.object for sample in samples})
    without = [(name,) for name in objects] + list(combinations(objects, 2))
    fits: list[tuple[str, Row]] = [("-".join(out), {"without": list(out)}) for out in without]
    fits += [(f"before{run}", {"before": run}) for run in range(1, 1 + runs[-1])]
    predictors = settings.predictors
    return [Cell(f"{one}+{name}", {"predictor": one, **values}) for one in predictors for name, values in fits]


def _run(cell: Cell, settings: PrequentialSettings, data: Dataset) -> list[Row]:
    samples, runs = _ordered(data)

    def predicted(train: Sequence[GraspSample], tested: Sequence[GraspSample]) -> Float64:
        fit = find_predictor(cell.values["predictor"], settings.training_fraction)
        return fit(train, labels_of(train), _SEED).predict(tested)

    if "before" in cell.values:
        return [{"expected": _before(samples, runs, cell.values["before"], predicted).tolist()}]
    without = cell.values["without"]
    train = [sample for sample in samples if sample.object not in without]
    own = [[sample for sample in samples if sample.object == name] for name in without]
    rows = [
        {"object": name, "expected": predicted(train, one).tolist()} for name, one in zip(without, own, strict=True)
    ]
    if len(without) == 1:
        rest, _ = rest_level(train)
        known = TimedReadings.of_samples(own[0], labels_of(own[0]), labels_of(own[0]), rest)
        fields = ("stamps_ns", "readings", "tares", "tdc", "tare_tdc")
        rows[0] |= {name: None if (values := getattr(known, name)) is None else values.tolist() for name in fields}
    return rows


def _before(samples: Sequence[GraspSample], runs: npt.NDArray[np.int_], run: int, predicted: Any) -> Float64:
    """(S, 50) predictions of all grasps up to the end of a run, by fits to other objects before it."""
    past, shown = (samples[: int(np.searchsorted(runs, end))] for end in (run, run + 1))
    names, target = np.array([sample.object for sample in shown]), shown[-1].object
    found = np.tile(labels_of(past).mean(axis=0), (len(shown), 1))
    for name in np.unique(names):
        train = [sample for sample in past if sample.object not in (name, target)]
        if len({sample.object for sample in train}) >= _FEWEST_OBJECTS:
            found[names == name] = predicted(train, [sample for sample in shown if sample.object == name])
    return found


def _tabulate(settings: PrequentialSettings, rows: Sequence[Row]) -> list[Row]:
    fits = {}
    for predictor, own in grouped([{"before": None, **row} for row in rows], "predictor"):
        recordings = _recordings([row for row in own if row["before"] is None])
        before = {row["before"]: np.array(row["expected"]) for row in own if row["before"] is not None}
        if recordings and len(before) == next(iter(recordings.values())).runs()[-1]:
            fits[predictor] = (recordings, before)
    return prequential_rows(fits, settings.bootstrap)


def _recordings(rows: Sequence[Row]) -> dict[str, TimedReadings]:
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
        recordings[target] = _joined(parts)
    return recordings


def _joined(parts: Sequence[dict[str, Any]]) -> TimedReadings:
    lengths = [len(part["stamps_ns"]) for part in parts]
    names = np.repeat([part["name"] for part in parts], lengths).astype(np.str_)
    stamps, readings, expected = (
        np.concatenate([np.array(part[key]) for part in parts]) for key in ("stamps_ns", "readings", "expected")
    )
    optional: dict[str, Any] = {}
    for key, width in (("tares", readings.shape[1]), ("tdc", 2), ("tare_tdc", 2)):
        rows = [
            np.full((n, width), np.nan) if part[key] is None else np.array(part[key])
            for n, part in zip(lengths, parts, strict=True)
        ]
        joined = np.concatenate(rows)
        optional[key] = None if np.isnan(joined).all() else joined
    return replace(TimedReadings(stamps, names, readings, expected), **optional).ordered()


EXPERIMENT = Experiment(
    name="prequential",
    question="What do vision, name, time, temperature, the hand's history and touches buy a robot at work?",
    module=__name__,
    order=5,
    settings=PrequentialSettings,
    presets={
        "full": {},
        "quick": {"predictors": [CONSTANT]},
        "smoke": {"predictors": [CONSTANT], "bootstrap.draws": 200},
    },
    load=load,
    cells=_cells,
    run=_run,
    tabulate=_tabulate,
    summarise=summarise_prequential,
    figure=draw_prequential,
    resumable_settings=("predictors", "bootstrap"),
    data_folder="vision2tactile",
)
