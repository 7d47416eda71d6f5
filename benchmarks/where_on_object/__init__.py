# SPDX-License-Identifier: Apache-2.0
"""What does it add to know where on the object its earlier touches were? Each grasp is predicted from all readings before it.

The tracker predicts a grasp from the state of the sensors, their temperature and the touches of the object, with the mean of
earlier readings in the place of vision: the geometry of the grasps is all that the camera adds. Its parameters, those of the
kernel on the geometry among them, are fitted without the object that is predicted. What stands for "where":

    level         nothing: the tracker as it was before
    where         the features of the grasp in the frame of the hand (`foretouch.models.contact.features`)

Samples without stamps, as of a simulated day, are taken object by object, a minute apart.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Final

import numpy as np

from foretouch.config import Settings
from foretouch.models.contact.features import CONDITIONS
from foretouch.models.state_space import TrackerParameters
from foretouch.models.tracker import SensorTracker
from foretouch.types import Float64, Sample
from foretouch_lab.experiments.framework.experiment import Cell, Experiment, Row, Table
from foretouch_lab.experiments.shared.scores import interval_columns, labelled
from foretouch_lab.experiments.shared.tables import ALL_OBJECTS, SIGNS, grouped, select, short, with_notes
from foretouch_lab.learning.data import labels_of, load_dataset
from foretouch_lab.learning.evaluation.metrics import MEAN, BootstrapConfig, ObjectErrors, compare, skills
from foretouch_lab.learning.prequential import TimedReadings, other_objects_mean, replay
from foretouch_lab.learning.training.calibration import HeldOutPredictions, fit_group, rest_level
from foretouch_lab.learning.training.contact import describe_samples
from foretouch_lab.learning.training.tracker import fit_places, fit_tracker

LEVEL, WHERE = "level", "where"
_MINUTE_NS: Final = 60 * 10**9
REGIMES: Final[Mapping[str, tuple[int, int]]] = {"first three": (0, 2), "later": (3, 10**9)}
"""Ranges of the number of touches of the object before a grasp, both ends included, by name."""


@dataclass(frozen=True, kw_only=True)
class WhereSettings(Settings):
    """Settings of the experiment."""

    bootstrap: BootstrapConfig = BootstrapConfig()


@dataclass(frozen=True, eq=False)
class Grasps:
    """Labelled grasps."""

    samples: list[Sample]  # in order of time
    sha256: str


def _load(_settings: WhereSettings, path: Path) -> Grasps:
    data = load_dataset(path)
    return Grasps(in_order(labelled(data)), data.sha256)


def in_order(samples: Sequence[Sample]) -> list[Sample]:
    """Return samples in order of time; object by object, a minute apart, where none has a stamp."""
    if any(sample.stamp_ns for sample in samples):
        return sorted(samples, key=lambda sample: sample.stamp_ns)
    samples = sorted(samples, key=lambda sample: sample.object)
    return [replace(sample, stamp_ns=(k + 1) * _MINUTE_NS) for k, sample in enumerate(samples)]


def features_of(samples: Sequence[Sample]) -> Float64:
    """Return (S, P) what is compared of the grasps: the features of `models.contact` without distance and density of the cloud."""
    return describe_samples(samples)[:, len(CONDITIONS) :]


def recorded(samples: Sequence[Sample]) -> TimedReadings:
    """Return readings in order of time, without tares; what is expected of each is the mean of all other objects."""
    labels = labels_of(samples)
    recording = TimedReadings.of_samples(samples, labels, labels, rest_level(samples)[0])
    return replace(recording, expected=other_objects_mean(recording), tares=None, tare_tdc=None)


def predicted(recording: TimedReadings, where: Float64 | None, target: str, parameters: TrackerParameters) -> Float64:
    """Return (S, D) predictions of the grasps on one object, each from earlier readings alone; NaN for the others.

    What is expected is the mean of the readings before the run on other objects. Nothing is predicted of the first run.
    """
    runs = recording.runs()
    counts = np.full(recording.readings.shape, np.nan)
    for run in np.unique(runs[(recording.objects == target) & (runs > 0)]):
        shown, last = runs <= run, runs == run
        others = (runs < run) & (recording.objects != target)
        before = replace(
            recording.take(shown),
            expected=np.tile(recording.readings[others].mean(axis=0), (shown.sum(), 1)),
            where=None if where is None else where[shown],
        )
        counts[last] = replay(SensorTracker(parameters), before).counts[last[shown]]
    return counts


def _cells(_settings: WhereSettings, data: Grasps) -> list[Cell]:
    names = sorted({sample.object for sample in data.samples})
    return [Cell(f"predict+{name}", {"object": name}) for name in names]


def _run(cell: Cell, _settings: WhereSettings, data: Grasps) -> list[Row]:
    target, recording = cell.values["object"], recorded(data.samples)
    own = recording.objects == target
    others = recording.take(~own)
    others = replace(others, expected=other_objects_mean(others))
    channels = data.samples[0].touch.channels  # type: ignore[union-attr]  # they are labelled
    held_out = HeldOutPredictions(others.expected, others.readings, others.objects, others.objects, channels)
    group = fit_group(held_out, new=True)
    level, features = fit_tracker(others, group, group), features_of(data.samples)
    reference = other_objects_mean(recording)
    touches = recording.touches()
    rows = []
    placed = fit_places(level, replace(others, where=features[~own]))
    for name, where, parameters in ((LEVEL, None, level), (WHERE, features, placed)):
        counts = predicted(recording, where, target, parameters)
        scored, off = np.isfinite(counts).all(axis=1), counts - recording.readings
        sums = {"squared": off**2, "reference": (reference - recording.readings) ** 2}
        for regime, (low, high) in REGIMES.items():
            chosen = scored & (touches >= low) & (touches <= high)
            if chosen.any():
                row: Row = {"variant": name, "regime": regime, "count": int(chosen.sum())}
                row |= {key: values[chosen].sum(axis=0).tolist() for key, values in sums.items()}
                rows.append(
                    row | {"modalities": {modality: channel.size for modality, channel in channels.channel_of.items()}}
                )
    return rows


_COLUMNS: Final = (
    *("variant", "regime", "object", "modality", "grasps", "skill", "skill_low", "skill_high", "gain", "gain_low"),
    *("gain_high", "gain_verdict"),
)


def _tabulate(settings: WhereSettings, cells: Sequence[Row]) -> list[Row]:
    """Return a row for each variant, regime and modality, and their mean, of all objects together."""
    sizes = cells[0]["modalities"]
    parts = np.split(np.arange(sum(sizes.values())), np.cumsum(list(sizes.values()))[:-1])
    columns = dict(zip(sizes, parts, strict=True))
    # What `metrics` reads of the channels of a sensor.
    channels: Any = SimpleNamespace(modality_columns=columns, modalities=tuple(sizes), size=sum(sizes.values()))
    rows: list[Row] = []
    for regime in REGIMES:
        own = dict(grouped(select(cells, regime=regime), "variant"))
        errors = {name: ObjectErrors.of_rows(variant_rows, channels) for name, variant_rows in own.items()}
        for name, variant_rows in own.items():
            estimates, grasps = skills(errors[name], settings.bootstrap), sum(row["count"] for row in variant_rows)
            gains = compare(errors[name], errors[LEVEL], settings.bootstrap)
            for modality in (*sizes, MEAN):
                row: Row = {"variant": name, "regime": regime, "object": ALL_OBJECTS, "modality": modality}
                row |= interval_columns("skill", estimates[modality]) | {"grasps": grasps}
                if name != LEVEL:
                    row |= interval_columns("gain", gains[modality]) | {"gain_verdict": gains[modality].verdict}
                rows.append({column: row.get(column) for column in _COLUMNS})
    return rows


def _summarise(rows: Sequence[Row]) -> list[Table]:
    tables = []
    for regime in REGIMES:
        own = select(rows, regime=regime)
        body = [[name, *(_cell(row) for row in part)] for name, part in grouped(own, "variant")]
        if own:
            columns = ["where", *dict.fromkeys(row["modality"] for row in own)]
            tables.append(Table(f"{regime}: {own[0]['grasps']} grasps", columns, body))
    notes = [
        "skill: 0 is the mean of all readings of the other objects, 1 is perfect; gain: skill minus that of level",
        "[95 % interval of the gain by bootstrap over objects]; ▲ ▼ =: significantly better, worse or not different from level",
        "first three: grasps before which the object was touched at most twice; later: all others",
    ]
    return with_notes(tables, notes)


def _cell(row: Mapping[str, Any]) -> str:
    if row["gain"] is None:
        return short(row["skill"])
    ends = "" if row["gain_low"] is None else f" [{row['gain_low']:+.3f}, {row['gain_high']:+.3f}]"
    return f"{short(row['skill'])} {SIGNS.get(row['gain_verdict'], '')} {row['gain']:+.3f}{ends}"


EXPERIMENT = Experiment(
    name="benchmarks.where_on_object",
    question="What does it add to know where on the object its earlier touches were?",
    module=__name__,
    settings=WhereSettings,
    presets={"full": {}, "quick": {}, "smoke": {"bootstrap.draws": 200}},
    load=_load,
    cells=_cells,
    run=_run,
    tabulate=_tabulate,
    summarise=_summarise,
    resumable_settings=("bootstrap",),
    data_folder="vision2tactile",
)
