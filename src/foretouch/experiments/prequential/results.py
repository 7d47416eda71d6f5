# SPDX-License-Identifier: Apache-2.0
"""Scores of the replay over touches of the object, as rows, tables and figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import numpy.typing as npt

from foretouch.experiments.framework.experiment import Row, Table
from foretouch.experiments.shared.figures import Line, draw_series, save_panels
from foretouch.experiments.shared.scores import interval_columns
from foretouch.experiments.shared.tables import (
    ALL_OBJECTS,
    findings,
    grouped,
    listed,
    pivot,
    select,
    short,
    unique,
    with_notes,
)
from foretouch.learning.evaluation.metrics import BootstrapConfig, ObjectErrors, compare, skills
from foretouch.learning.evaluation.prequential import BINS, Recording, baselines, other_objects_mean, replay
from foretouch.learning.training.calibration import HeldOutPredictions, fit_group
from foretouch.learning.training.tracker import fit_tracker
from foretouch.models.calibration import Calibration
from foretouch.models.state_space import FINGERS, TrackerParameters
from foretouch.models.tracker import SensorTracker
from foretouch.report.panels import Rows
from foretouch.tactile import FULL_SCALE, MODALITIES, columns
from foretouch.types import TOUCH_SIZE, Float64

if TYPE_CHECKING:
    from matplotlib.axes import Axes

TRACKER: Final = "tracker"
MEMORY: Final = "memory"
"""A tracker whose state ends with the object."""

VISION: Final = "vision"
"""The predictions that know no reading."""

PAST: Final = "past_mean"
LATER: Final = "4th on"
"""All grasps of an object from the fourth on: the coverage of single objects."""

AFTER_JUMP: Final = "after jump"
_JUMP: Final = 100.0  # [counts]
_JUMP_AFTER: Final = 25  # touches of the object
_JUMP_GRASPS: Final = 50
_RANGES: Final = {**BINS, LATER: (3, 10**9)}
_OBJECT_BINS: Final = ("first 3", "3-9", "10+", "all", LATER)
_FINGER_OF: Final = dict(zip(MODALITIES, (*FINGERS, *FINGERS), strict=True))
_COLUMNS: Final = (
    *(VISION, "method", "bin", "object", "modality", "grasps", "skill", "skill_low", "skill_high"),
    *("vs_memory_verdict", "coverage", "half_width", "width_at_equal_coverage", "noticed_after"),
)


@dataclass(frozen=True, eq=False)
class _Scored:
    """Predictions of grasps, those of each object from a replay without it."""

    recording: Recording
    counts: dict[str, Float64]  # by method, (S, 50); NaN where a method predicts nothing [counts]
    half: dict[str, Float64]  # by method, (S, 50) [counts]

    def add(self, method: str, where: npt.NDArray[np.bool_], counts: Float64, half: Float64 | None = None) -> None:
        """Set the predictions of some grasps, and the half widths of their intervals."""
        for kept, values in ((self.counts, counts), (self.half, half)):
            if values is not None:
                kept.setdefault(method, np.full(self.recording.readings.shape, np.nan))[where] = values


def prequential_rows(
    predictor: str, recordings: Mapping[str, Recording], config: BootstrapConfig, *, past: bool = False
) -> list[Row]:
    """Rows of `results.csv` for one predictor that knows no reading.

    Args:
        predictor: Its name.
        recordings: By object: all readings, with predictions that are not of the object.
        config: Configuration of the bootstrap.
        past: Whether the mean of all readings before the object was taken is scored as predictor as well.
    """
    first = next(iter(recordings.values()))
    whole, strict = _Scored(first, {}, {}), _Scored(first, {}, {})
    jumps: list[Row] = []
    for name, recording in recordings.items():
        own, runs = recording.objects == name, recording.runs()
        others = recording.take(~own)
        group = fit_group(
            HeldOutPredictions(others.expected, others.readings, others.objects, others.objects), new=True
        )
        calibration = Calibration(np.zeros(TOUCH_SIZE), {"new": group, "known": group})
        fitted = {TRACKER: fit_tracker(others, group, group), MEMORY: calibration.tracker_parameters}
        for method, parameters in fitted.items():
            keep = method == TRACKER
            played = replay(SensorTracker(parameters), recording, keep_sensors=keep)
            whole.add(method, own, played.counts[own], played.half[own])
            for run in np.unique(runs[own]) if past else ():
                if run:
                    played = replay(SensorTracker(parameters), with_past_mean(recording, int(run)), keep_sensors=keep)
                    last = runs[runs <= run] == run
                    strict.add(method, runs == run, played.counts[last], played.half[last])
        others_mean = other_objects_mean(recording)
        for method, values in ({VISION: recording.expected} | baselines(recording, others_mean)).items():
            whole.add(method, own, values[own])
        jumps += _jump_rows(name, recording, fitted[TRACKER])
    rows = [{VISION: predictor, **row} for row in [*_score_rows(whole, config), *jumps]]
    rows += [{VISION: PAST, **row} for row in _score_rows(strict, config)] if past else []
    return [{name: row.get(name) for name in _COLUMNS} for row in rows]


def with_past_mean(recording: Recording, run: int) -> Recording:
    """A recording up to the end of a run of grasps, with the mean of all readings before that run as prediction."""
    runs = recording.runs()
    shown = recording.take(runs <= run)
    mean = recording.readings[runs < run].mean(axis=0)
    return replace(shown, expected=np.tile(mean, (len(shown.readings), 1)))


def _jump_rows(name: str, recording: Recording, parameters: TrackerParameters) -> list[Row]:
    """Coverage of the grasps after all values jump while an object is touched."""
    own = np.flatnonzero(recording.objects == name)
    first = own[min(_JUMP_AFTER, len(own) - 1)]
    readings = recording.readings.copy()
    readings[first:] = np.clip(readings[first:] + _JUMP, 0.0, FULL_SCALE)
    tares = None if recording.tares is None else recording.tares.copy()
    if tares is not None:
        tares[first + 1 :] += _JUMP
    played = replay(SensorTracker(parameters), replace(recording, readings=readings, tares=tares))
    after = slice(first, first + _JUMP_GRASPS)
    inside = (np.abs(readings - played.counts) <= played.half)[after]
    rows: list[Row] = []
    for modality in MODALITIES:
        noticed = [k for k, fingers in enumerate(played.restarted[after]) if _FINGER_OF[modality] in fingers]
        found = {
            "coverage": inside[:, columns([modality])].mean(),
            "noticed_after": noticed[0] + 1 if noticed else None,
        }
        place = {"method": TRACKER, "bin": AFTER_JUMP, "object": name, "modality": modality, "grasps": len(inside)}
        rows.append(place | found)
    return rows


def _score_rows(scored: _Scored, config: BootstrapConfig) -> list[Row]:
    """A row for each method, range of touches, object and modality."""
    recording = scored.recording
    reference, touches = other_objects_mean(recording), recording.touches()
    predicted = np.isfinite(scored.counts[TRACKER]).all(axis=1)
    rows: list[Row] = []
    for label, (low, high) in _RANGES.items():
        chosen = (touches >= low) & (touches <= high) & predicted
        if not chosen.any():
            continue
        errors = {method: _errors(recording, values, reference, chosen) for method, values in scored.counts.items()}
        for method, own in errors.items():
            estimates = skills(own, config)
            versus = compare(own, errors[MEMORY], config) if method != MEMORY else {}
            by_object = own.objects if method in scored.half and label in _OBJECT_BINS else ()
            single = {name: skills(own.only(name), config) for name in by_object}
            for modality in MODALITIES:
                place = {"method": method, "bin": label, "modality": modality}
                verdict = versus[modality].verdict if versus else None
                skill = {**interval_columns("skill", estimates[modality]), "vs_memory_verdict": verdict}
                intervals = _interval_columns(scored, method, modality, chosen)
                rows.append({**place, "object": ALL_OBJECTS, **skill, **intervals})
                for name, found in single.items():
                    mine = _interval_columns(scored, method, modality, chosen & (recording.objects == name))
                    rows.append({**place, "object": name, "skill": found[modality].value, **mine})
    return rows


def _errors(recording: Recording, values: Float64, reference: Float64, chosen: npt.NDArray[np.bool_]) -> ObjectErrors:
    parts = []
    for name in np.unique(recording.objects[chosen]):
        own = chosen & (recording.objects == name)
        squared, base = ((recording.readings[own] - other[own]) ** 2 for other in (values, reference))
        parts.append((str(name), float(own.sum()), squared.sum(axis=0), base.sum(axis=0)))
    return ObjectErrors.total(parts)


def _interval_columns(scored: _Scored, method: str, modality: str, chosen: npt.NDArray[np.bool_]) -> Row:
    """Coverage and mean half width, and the latter over that of the memory scaled to the same coverage."""
    result: Row = {"grasps": int(chosen.sum())}
    if method not in scored.half:
        return result
    rows = np.ix_(chosen, columns([modality]))
    readings, half = scored.recording.readings[rows], scored.half[method][rows]
    coverage = float((np.abs(readings - scored.counts[method][rows]) <= half).mean())
    result |= {"coverage": coverage, "half_width": float(half.mean())}
    if method != MEMORY:
        memory = scored.half[MEMORY][rows]
        scale = float(np.quantile(np.abs(readings - scored.counts[MEMORY][rows]) / memory, coverage))
        result["width_at_equal_coverage"] = float(half.mean() / (scale * memory.mean()))
    return result


def summarise_prequential(rows: Sequence[Row]) -> list[Table]:
    """Tables of skill over touches, each object, intervals and jump, for each predictor that knows no reading."""
    tables, sentences = [], []
    for vision, own in grouped(rows, VISION):
        tables += [replace(table, title=f"{vision}: {table.title}") for table in _tables(own)]
        sentences += [f"{vision}: {text}" for text in _sentences(own)]
    notes = [
        "skill: 0 is the mean of all readings of the other objects, earlier and later; the four numbers are PDC_TH, PDC_MF, E_TH, E_MF",
        "touches: of the object, since it was taken; an object that returns begins with 0",
        f"▲ ▼: significantly better or worse than `{MEMORY}`, a tracker that ends with the object (95 % interval by bootstrap over objects)",
        f"vision is fitted to all other objects, later ones included; `{PAST}` uses earlier readings only (the parameters of tracker and memory do not)",
        f"width: mean half width over that of `{MEMORY}`, after the latter was scaled to the same coverage",
    ]
    return [findings(sentences), *with_notes(tables, notes)]


def _sentences(rows: Rows) -> list[str]:
    """Skills and coverage of the tracker."""
    together = dict(grouped(select(rows, method=TRACKER, object=ALL_OBJECTS), "bin"))
    before = f"{listed(together['none'], 'skill')} before the first touch of an object, " if "none" in together else ""
    first, every = listed(together["first 3"], "skill"), listed(together["all"], "skill")
    later = [row["coverage"] for row in select(rows, method=TRACKER, bin=LATER) if row["object"] != ALL_OBJECTS]
    text = f"its 90 % intervals cover {listed(together['all'], 'coverage')}"
    text += f", of each object from its fourth grasp at least {short(min(later))}" if later else ""
    if jumps := [row["coverage"] for row in select(rows, bin=AFTER_JUMP)]:
        text += (
            f", and after a jump of all values {short(float(np.mean(jumps)))} on average, at least {short(min(jumps))}"
        )
    return [f"the tracker has skills of {before}{first} on its first three grasps, {every} on all", text]


def _tables(rows: Rows) -> list[Table]:
    """Tables of skill over touches, of each object, of intervals, and after a jump if there is one."""
    together = [row for row in select(rows, object=ALL_OBJECTS) if row["bin"] in BINS]
    labels = unique(together, "bin")
    counts = [f"{label} ({select(together, bin=label)[0]['grasps']})" for label in labels]
    lines = [
        {**row, "line": f"{method}, {row['bin']}"}
        for method in (TRACKER, MEMORY)
        for row in select(rows, method=method)
        if row["object"] != ALL_OBJECTS
        and row["bin"] in ("first 3", "3-9", "all")  # a single grasp has no skill of its own
    ]
    objects = sorted(set(unique(lines, "object")))
    body = pivot(lines, "line", partial(_four, "skill"), "object", objects)
    for line, (_, own) in zip(body, grouped(lines, "line"), strict=True):
        lowest = (min(row["skill"] for row in one) for _, one in grouped(own, "modality"))
        line.append(" ".join(f"{skill:.2f}" for skill in lowest))
    tables = [
        Table("skill over touches", ["method", *counts], pivot(together, "method", _skills, "bin", labels)),
        Table("skill of each object", ["touches", *objects, "worst"], body),
        Table("90 % intervals", ["touches", "coverage", "half width [counts]", "width"], _intervals(rows)),
    ]
    if jumps := select(rows, bin=AFTER_JUMP):
        body = [
            [name, _four("coverage", *own), _four("noticed_after", *own)]
            for name, own in sorted(grouped(jumps, "object"))
        ]
        means = " ".join(f"{np.mean([row['coverage'] for row in own]):.2f}" for _, own in grouped(jumps, "modality"))
        names = ["while touching", "coverage", "finger restarted after touches"]
        title = f"{_JUMP_GRASPS} grasps after a jump of all values"
        tables.append(Table(title, names, [*body, ["mean", means, ""]]))
    return tables


def _intervals(rows: Rows) -> list[list[str]]:
    """Coverage and width of each range of touches, and of each object from the fourth grasp on."""
    body = []
    for method in (TRACKER, MEMORY):
        own = select(rows, method=method)
        for label, cells in grouped(select(own, object=ALL_OBJECTS), "bin"):
            if label in ("none", "first 3", "3-9", "10+", "all"):
                texts = (_four(key, *cells) for key in ("coverage", "half_width", "width_at_equal_coverage"))
                body.append([f"{method}, {label}", *texts])
        for name, cells in grouped(select(own, bin=LATER), "object"):
            if name != ALL_OBJECTS:
                texts = (_four(key, *cells) for key in ("coverage", "half_width"))
                body.append([f"{method}, {name} from the 4th grasp", *texts, ""])
    return body


def _skills(*rows: Row) -> str:
    signs = {"better": "▲", "worse": "▼"}
    return " ".join(f"{row['skill']:.2f}{signs.get(row['vs_memory_verdict'], '')}" for row in rows)


def _four(key: str, *rows: Mapping[str, Any]) -> str:
    decimals = 0 if key in ("half_width", "noticed_after") else 2
    return " ".join("–" if row[key] is None else f"{row[key]:.{decimals}f}" for row in rows)


def draw_prequential(rows: Rows, folder: Path) -> list[Path]:
    """Draw `touches.png`: skill over touches, with 95 % intervals of the first two; below it width and coverage."""
    vision, shown = rows[0][VISION], (TRACKER, MEMORY, "object mean", "clock", "running mean", VISION)
    labels = [
        label for label in ("none", "1 touch", "2 touches", "3-9", "10+") if select(rows, vision=vision, bin=label)
    ]
    own = [row for row in select(rows, vision=vision, object=ALL_OBJECTS) if row["bin"] in labels]
    # Intervals of the first two alone: six would hide each other.
    skills_ = [row if row["method"] in (TRACKER, MEMORY) else {**row, "skill_low": None} for row in own]
    widths = [row for row in own if row["coverage"] is not None]
    draw = partial(draw_series, x="bin", series="method", places=labels)

    def _draw_skill(axes: Axes, rows: Rows) -> None:
        draw(axes, rows, names=shown, spread=0.08)
        axes.set_ylim(-0.6, 1.0)

    def _draw_width(axes: Axes, rows: Rows) -> None:
        draw(axes, rows, names=(TRACKER, MEMORY), values="half_width")
        for row in rows:
            number, place = (TRACKER, MEMORY).index(row["method"]), (labels.index(row["bin"]), row["half_width"])
            how: Any = {"ha": "center", "fontsize": 8, "color": f"C{number}", "textcoords": "offset points"}
            axes.annotate(f"{row['coverage']:.2f}", place, (0, 6 if number else -13), **how)
        axes.set_xticks(range(len(labels)), [label.split()[0] for label in labels])
        axes.set_ylim(bottom=0.0)

    lines = [
        Line(2.4, skills_, _draw_skill, y_label=f"skill (vision: {vision})", legend="lower center"),
        Line(2.4, widths, _draw_width, "", "touches of the object", "half width [counts], coverage"),
    ]
    return save_panels(folder / "touches.png", 9.0, lines, sharex=True)
