# SPDX-License-Identifier: Apache-2.0
"""Scores of the sources of knowledge, as rows, tables and a figure."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from foretouch.models.calibration import Calibration
from foretouch.models.state_space import TrackerParameters
from foretouch.models.tracker import MISS_RATE, SensorTracker
from foretouch.report.panels import Rows
from foretouch.tactile import BIOTAC, MODALITIES, TOUCH_SIZE
from foretouch.types import Bool, Float64
from foretouch_lab.experiments.framework.experiment import Row, Table
from foretouch_lab.experiments.shared.figures import Line, draw_intervals, save_panels
from foretouch_lab.experiments.shared.scores import interval_columns
from foretouch_lab.experiments.shared.tables import (
    ALL_OBJECTS,
    grouped,
    interval_text,
    pivot,
    select,
    unique,
    with_notes,
)
from foretouch_lab.learning.evaluation.metrics import BootstrapConfig, ObjectErrors, compare, skills
from foretouch_lab.learning.prequential import TimedReadings, other_objects_mean, replay
from foretouch_lab.learning.training.calibration import HeldOutPredictions, fit_group
from foretouch_lab.learning.training.tracker import fit_tracker

CONSTANT: Final = "training_mean"
"""The predictor without vision."""

NOTHING: Final = "nothing"
TOUCHES: Final = "touches"
HISTORY: Final = "history"
EVERYTHING: Final = "history + touches + temperature"
SOURCES: Final = (
    *(NOTHING, "name", "time", "temperature", HISTORY, "history + temperature", TOUCHES, "history + touches"),
    *("history + touches + tares", "history + touches + last temperature", EVERYTHING),
)
"""What is known besides vision: names of the rows, from the least to the most."""

REGIMES: Final[Mapping[str, tuple[int, int]]] = {
    "never touched": (0, 0),
    "first three": (0, 2),
    "later": (3, 10**9),
    "all": (0, 10**9),
}
"""Ranges of the number of touches of the object before a grasp, both ends included, by name."""

CLOCK_S: Final = 86400.0
"""Time constant of the weights of the readings where the time alone is known [s]."""

_COLUMNS: Final = (
    *("vision", "sources", "regime", "object", "modality", "grasps", "skill", "skill_low", "skill_high"),
    *("vs_constant", "vs_constant_low", "vs_constant_high", "vs_constant_verdict"),
    *("coverage", "half_width", "interval_score"),
)


class _Scored(NamedTuple):
    """Readings of all runs by one predictor, and predictions of them from each of the sources."""

    recording: TimedReadings  # with the predictions by vision alone
    counts: dict[str, Float64]  # by sources, (S, 50); NaN in the first run [counts]
    half: dict[str, Float64]  # by sources, (S, 50) half widths of those with intervals [counts]


def _joined(rows: Sequence[Row]) -> _Scored:
    """Join the rows of all runs."""
    rows = sorted(rows, key=lambda row: row["run"])
    numbers = [len(row["readings"]) for row in rows]
    readings = np.concatenate([row["readings"] for row in rows])
    objects, runs = (np.repeat([row[key] for row in rows], numbers) for key in ("name", "run"))
    unknown = np.full((numbers[0], readings.shape[1]), np.nan)  # of the first run nothing is predicted

    def joined(what: str) -> dict[str, Float64]:
        return {name: np.concatenate([unknown, *(row[what][name] for row in rows[1:])]) for name in rows[-1][what]}

    counts, half = joined("counts"), joined("half")
    return _Scored(TimedReadings(runs, objects.astype(np.str_), readings, counts[NOTHING]), counts, half)


def score_sources(by_predictor: Mapping[str, Sequence[Row]], config: BootstrapConfig) -> list[Row]:
    """Return rows of `results.csv`.

    Args:
        by_predictor: By name of a predictor by vision, the rows of its cells; a predictor that lacks a run is left out.
        config: Configuration of the bootstrap.
    """
    scored = {name: _joined(rows) for name, rows in by_predictor.items() if len(rows) == rows[0]["runs"]}
    rows = [
        {"vision": name} | row
        for name, predictions in scored.items()
        for row in _score_rows(predictions, scored.get(CONSTANT), config)
    ]
    return [{name: row.get(name) for name in _COLUMNS} for row in rows]


def tracker_parameters(others: TimedReadings) -> tuple[TrackerParameters, TrackerParameters]:
    """Fit the parameters of a tracker, and of one that ends with the object, to readings of other objects."""
    held_out = HeldOutPredictions(others.expected, others.readings, others.objects, others.objects, BIOTAC)
    group = fit_group(held_out, new=True)
    ending = Calibration(BIOTAC, np.zeros(TOUCH_SIZE), {"new": group, "known": group}).tracker_parameters
    return fit_tracker(others, group, group), ending


def predict_run(
    shown: TimedReadings, tracker: TrackerParameters, ending: TrackerParameters
) -> dict[str, dict[str, Float64]]:
    """Return predictions of the last run of a recording from each of the sources, and half widths of those with intervals.

    Args:
        shown: The readings of the recording, in order of time.
        tracker: Parameters that were fitted to other objects.
        ending: The same of a tracker that ends with its object.

    Returns:
        `counts` and `half`, both by sources, (S, 50) [counts].
    """
    last = shown.runs() == shown.runs()[-1]
    cold = replace(shown, tares=None, tdc=None, tare_tdc=None)
    own = ~last & (shown.objects == shown.objects[-1])
    named = shown.readings[own].mean(axis=0) if own.any() else shown.expected[last]
    counts = {NOTHING: shown.expected[last], "name": np.broadcast_to(named, shown.expected[last].shape)}
    counts["time"] = _clock(shown, last)
    untouched = np.where(last[:, None], np.nan, shown.readings)
    played = {
        HISTORY: (tracker, replace(cold, readings=untouched)),
        TOUCHES: (ending, cold),
        "history + touches": (tracker, cold),
    }
    if shown.tares is not None:
        played["history + touches + tares"] = (tracker, replace(cold, tares=shown.tares))
    if shown.tdc is not None:
        earlier = replace(shown, tare_tdc=np.concatenate([shown.tdc[:1], shown.tdc[:-1]]))
        before = np.array([shown.tdc_before(k) for k in range(len(last))])
        known = np.isfinite(before) & ~last[:, None]
        mean = np.where(known, before, 0.0).sum(axis=0) / np.maximum(known.sum(axis=0), 1)
        change = np.nan_to_num(before - np.where(known.any(axis=0), mean, np.nan))[:, BIOTAC.finger_of_value]
        counts["temperature"] = (shown.expected + tracker.slope * change)[last]
        played |= {"history + temperature": (tracker, replace(shown, readings=untouched)), EVERYTHING: (tracker, shown)}
        if shown.tare_tdc is None:
            played["history + touches + last temperature"] = (tracker, earlier)
    half = {}
    for sources, (parameters, recording) in played.items():
        replayed = replay(SensorTracker(parameters), recording, keep_sensors=parameters is tracker)
        counts[sources], half[sources] = replayed.counts[last], replayed.half[last]
    return {"counts": counts, "half": half}


def _clock(shown: TimedReadings, last: Bool) -> Float64:
    """Return readings of earlier runs with weights that fall by e in a day, and vision as far as it differs from its own."""
    past = shown.take(~last)
    seconds = shown.stamps_ns / 1e9
    weights = np.exp(-(seconds[last][:, None] - seconds[~last]) / CLOCK_S) + 1e-12
    weights /= weights.sum(axis=1, keepdims=True)
    return np.asarray(shown.expected[last] + weights @ (past.readings - past.expected), np.float64)


def _score_rows(scored: _Scored, constant: _Scored | None, config: BootstrapConfig) -> list[Row]:
    """Return a row for each of the sources, regime and modality, and for each object with all sources.

    `constant` is the predictor without vision, which the others are compared with.
    """
    rows: list[Row] = []
    recording = scored.recording
    touches, reference = recording.touches(), other_objects_mean(recording)
    for regime, (low, high) in REGIMES.items():
        chosen = (touches >= low) & (touches <= high) & np.isfinite(recording.expected).all(axis=1)
        names, known = recording.objects[chosen].tolist(), (recording.readings[chosen], reference[chosen])
        for sources in (source for source in SOURCES if source in scored.counts):
            errors, without = (
                ObjectErrors.of_predictions(names, predictor.counts[sources][chosen], *known, BIOTAC)
                for predictor in (scored, constant or scored)
            )
            scores = {ALL_OBJECTS: skills(errors, config)}
            if regime == "later" and sources == EVERYTHING:
                scores |= {name: skills(errors.only(name), config) for name in errors.objects}
            versus = None if constant is None or constant is scored else compare(errors, without, config)
            for name, skill in scores.items():
                where = chosen if name == ALL_OBJECTS else chosen & (recording.objects == name)
                for modality in MODALITIES:
                    row: Row = {"sources": sources, "regime": regime, "object": name, "modality": modality}
                    row |= interval_columns("skill", skill[modality]) | _interval_scores(
                        scored, sources, modality, where
                    )
                    if versus and name == ALL_OBJECTS:
                        row |= interval_columns("vs_constant", versus[modality])
                        row["vs_constant_verdict"] = versus[modality].verdict
                    rows.append(row)
    return rows


def _interval_scores(scored: _Scored, sources: str, modality: str, chosen: Bool) -> Row:
    """Return the number of grasps; coverage, mean half width and mean score of the 90 % intervals [Gneiting and Raftery 2007, eq. 43].

    The score is the width of an interval, and 20 times the distance of a reading from it where it is outside: the lower
    the better, so that neither wide intervals nor missed readings gain anything.
    """
    result: Row = {"grasps": int(chosen.sum())}
    if sources in scored.half:
        rows = np.ix_(chosen, BIOTAC.columns([modality]))
        half = scored.half[sources][rows]
        beyond = np.abs(scored.recording.readings[rows] - scored.counts[sources][rows]) - half
        score = 2.0 * half + 2.0 / MISS_RATE * np.maximum(beyond, 0.0)
        result |= {"coverage": float((beyond <= 0.0).mean()), "half_width": float(half.mean())}
        result["interval_score"] = float(score.mean())
    return result


def summarise_prequential(rows: Sequence[Row]) -> list[Table]:
    """Return what each source buys, the intervals, and the coverage of each object."""
    together = select(rows, object=ALL_OBJECTS)
    notes = [
        "skill: 0 is the mean of all readings of the other objects, earlier and later; 1 is perfect; [95 % interval by bootstrap over objects]",
        "never touched: the first grasp of a run on an object; first three: grasps before which it was touched at most twice; later: all others",
        "gain of vision: skill with it minus skill with the mean of earlier readings in its place, [95 % interval of the same draws of objects]",
        "▲ ▼ =: vision is significantly better, worse or not different from the mean of earlier readings, with the same sources",
        "nothing: vision or the mean alone; name: mean of earlier runs on the object; time: earlier readings with weights that fall by e in a day",
        "history: the state of the sensors from readings on other objects; touches: of this object, in this run",
        "interval score [counts]: width, plus 20 times the distance of readings outside; the lower the better",
    ]
    tables = []
    for regime in REGIMES:
        own = select(together, regime=regime)
        title = f"{regime}: {own[0]['grasps']} grasps"
        tables.append(
            Table(title, ["known", *MODALITIES], pivot(_with_lines(own), "line", partial(_text, column="skill")))
        )
    compared = [
        {**row, "line": f"{row['regime']}, {row['sources']}"} for row in together if row["vs_constant"] is not None
    ]
    for vision, own in grouped(compared, "vision"):
        body = pivot(own, "line", partial(_text, column="vs_constant"))
        tables.append(Table(f"Gain of vision, {vision}", ["known besides vision", *MODALITIES], body))
    scored = [row for row in together if row["interval_score"] is not None]
    for vision, own in grouped(scored, "vision"):
        body = [
            [f"{regime}, {sources}", *(_four(key, part) for key in ("coverage", "half_width", "interval_score"))]
            for (regime, sources), part in grouped(own, "regime", "sources")
        ]
        tables.append(Table(f"90 % intervals, {vision}", ["known", "coverage", "half width [counts]", "score"], body))
    single = [row for row in rows if row["object"] != ALL_OBJECTS]
    for vision, own in grouped(single, "vision"):
        body = [
            [f"{name}, {regime}", _four("coverage", part)] for (regime, name), part in grouped(own, "regime", "object")
        ]
        tables.append(Table(f"each object, {vision}", ["object", "coverage"], body))
    return with_notes(tables, notes)


_text = partial(interval_text, verdict="vs_constant_verdict", between=" ")


def _with_lines(rows: Rows) -> list[Row]:
    """Return rows with the name of their `line` in tables and figure, rows of one source together."""
    named = [{**row, "line": row["sources"] + ("" if row["vision"] == CONSTANT else " + vision")} for row in rows]
    return sorted(named, key=lambda row: SOURCES.index(row["sources"]))


def _four(key: str, rows: Sequence[Mapping[str, Any]]) -> str:
    decimals = 2 if key == "coverage" else 0
    return " ".join("–" if row[key] is None else f"{row[key]:.{decimals}f}" for row in rows)


def draw_prequential(rows: Rows, folder: Path) -> list[Path]:
    """Draw `sources.png`: for each regime and modality, the skill of all sources, without vision and with it."""
    named = _with_lines(select(rows, object=ALL_OBJECTS))
    lines = unique(named, "line")

    def colour(row: Mapping[str, Any]) -> str:
        return f"C{int(row['vision'] != CONSTANT)}"

    draw = partial(draw_intervals, column="line", names=lines, lowest=-0.8, colour=colour)
    panels = [
        Line(0.8 + 0.22 * len(lines), select(named, regime=regime), draw, regime, "skill")
        for regime in ("never touched", "first three", "later")
    ]
    return save_panels(folder / "sources.png", 12.0, panels, sharex=True, sharey=True)
