# SPDX-License-Identifier: Apache-2.0
"""Scores of the replay over touches of the object, as rows, tables and figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import numpy.typing as npt

from foretouch.experiments.framework.experiment import Row, Table
from foretouch.experiments.shared.scores import ALL_OBJECTS
from foretouch.learning.evaluation.metrics import ObjectErrors, compare, skills
from foretouch.learning.evaluation.prequential import BINS, Recording, baselines, other_objects_mean, replay
from foretouch.learning.training.calibration import HeldOutPredictions, fit_group
from foretouch.learning.training.tracker import fit_tracker
from foretouch.models.calibration import Calibration
from foretouch.models.state_space import FINGERS
from foretouch.models.tracker import SensorTracker
from foretouch.report.panels import Rows, new_figure, save
from foretouch.tactile import FULL_SCALE, MODALITIES, columns
from foretouch.types import TOUCH_SIZE, Float64

if TYPE_CHECKING:
    from matplotlib.axes import Axes

TRACKER: Final = "tracker"
MEMORY: Final = "memory"
"""A tracker that ends with the object."""

SIGHT: Final = "sight"
LATER: Final = "4th on"
"""All grasps of an object from the fourth on: the coverage of single objects."""

AFTER_JUMP: Final = "after jump"
_JUMP_GRASPS: Final = 50
_PAST: Final = "past_mean"
_RANGES: Final = {**BINS, LATER: (3, 10**9)}
_OBJECT_BINS: Final = ("first 3", "3-9", "10+", "all", LATER)
_FINGER_OF: Final = dict(zip(MODALITIES, (*FINGERS, *FINGERS), strict=True))


@dataclass(frozen=True, eq=False)
class _Scored:
    """Predictions of all grasps, those of each object from a replay without it."""

    recording: Recording
    counts: dict[str, Float64]  # by method, (S, 50); NaN where a method predicts nothing [counts]
    half: dict[str, Float64]  # by method, (S, 50) [counts]


def prequential_rows(
    predictor: str, recordings: Mapping[str, Recording], settings: Any, *, past: bool = False
) -> list[Row]:
    """Rows of `results.csv` for one predictor by sight.

    Args:
        predictor: Its name.
        recordings: By object: all readings, with predictions that are not of the object.
        settings: Of the experiment.
        past: Whether the predictor that knows the past only is scored as well.
    """
    any_recording = next(iter(recordings.values()))
    shape = any_recording.readings.shape
    counts: dict[str, Float64] = {}
    half = {name: np.full(shape, np.nan) for name in (TRACKER, MEMORY)}
    strict = np.full(shape, np.nan), np.full(shape, np.nan)
    jumps: list[Row] = []
    for name, recording in recordings.items():
        own = recording.objects == name
        others = recording.take(~own)
        group = fit_group(
            HeldOutPredictions(others.expected, others.readings, others.objects, others.objects), new=True
        )
        tracker = SensorTracker(fit_tracker(others, group, group))
        parameters = tracker.parameters
        played = replay(tracker, recording)
        forgetful = SensorTracker(Calibration(np.zeros(TOUCH_SIZE), {"new": group, "known": group}).tracker_parameters)
        memory = replay(forgetful, recording, keep_sensors=False)
        found = {TRACKER: played.counts, MEMORY: memory.counts, SIGHT: recording.expected}
        for method, values in (found | baselines(recording, other_objects_mean(recording))).items():
            counts.setdefault(method, np.full(shape, np.nan))[own] = values[own]
        half[TRACKER][own], half[MEMORY][own] = played.half[own], memory.half[own]
        jumps += _jump_rows(name, recording, SensorTracker(parameters), settings)
        for run in np.unique(recording.runs()[own]) if past else ():
            if run:
                _replay_past(SensorTracker(parameters), recording, int(run), strict)
    scored = _Scored(any_recording, counts, half)
    head = {"sight": predictor}
    rows = [{**head, **row} for row in [*_score_rows(scored, settings), *jumps]]
    if past:
        only = np.isfinite(strict[0]).all(axis=1)
        kept = {TRACKER: strict[0][only], MEMORY: counts[MEMORY][only]}
        halves = {TRACKER: strict[1][only], MEMORY: half[MEMORY][only]}
        reference = other_objects_mean(any_recording)[only]
        touches = any_recording.touches()[only]
        chosen = _Scored(any_recording.take(only), kept, halves)
        rows += [{"sight": _PAST, **row} for row in _score_rows(chosen, settings, reference, touches)]
    return rows


def _replay_past(tracker: SensorTracker, recording: Recording, run: int, into: tuple[Float64, Float64]) -> None:
    """Predict one run of grasps with the mean of all readings before it as prediction by sight."""
    runs = recording.runs()
    past = runs < run
    mean = recording.readings[past].mean(axis=0)
    shown = recording.take(runs <= run)
    if shown.tares is not None and recording.tares is not None:
        known = np.isfinite(recording.tares[past]).all(axis=1)
        level = recording.tares[past][known].mean(axis=0) if known.any() else np.nan
        shown = replace(shown, tares=shown.tares - level)
    played = replay(tracker, replace(shown, expected=np.tile(mean, (len(shown.readings), 1))))
    into[0][runs == run] = played.counts[runs[runs <= run] == run]
    into[1][runs == run] = played.half[runs[runs <= run] == run]


def _jump_rows(name: str, recording: Recording, tracker: SensorTracker, settings: Any) -> list[Row]:
    """Coverage of the grasps after all values jump while an object is touched."""
    first = np.flatnonzero(recording.objects == name)[
        min(settings.jump_after, int((recording.objects == name).sum()) - 1)
    ]
    readings = recording.readings.copy()
    readings[first:] = np.clip(readings[first:] + settings.jump, 0.0, FULL_SCALE)
    tares = None if recording.tares is None else recording.tares.copy()
    if tares is not None:
        tares[first + 1 :] += settings.jump
    played = replay(tracker, replace(recording, readings=readings, tares=tares))
    after = slice(first, first + _JUMP_GRASPS)
    inside = (np.abs(readings - played.counts) <= played.half)[after]
    rows = []
    for modality in MODALITIES:
        noticed = [k for k, fingers in enumerate(played.restarted[after]) if _FINGER_OF[modality] in fingers]
        rows.append(
            {
                "method": TRACKER,
                "bin": AFTER_JUMP,
                "object": name,
                "modality": modality,
                "grasps": len(inside),
                "coverage": _rounded(inside[:, columns([modality])].mean()),
                "noticed_after": noticed[0] + 1 if noticed else None,
            }
        )
    return [{**_EMPTY, **row} for row in rows]


_EMPTY: Final[Row] = dict.fromkeys(
    (
        "method",
        "bin",
        "object",
        "modality",
        "grasps",
        "skill",
        "skill_low",
        "skill_high",
        "vs_memory",
        "vs_memory_low",
        "vs_memory_high",
        "vs_memory_verdict",
        "coverage",
        "half_width",
        "width_at_equal_coverage",
        "noticed_after",
    )
)


def _score_rows(
    scored: _Scored, settings: Any, reference: Float64 | None = None, touches: npt.NDArray[np.int_] | None = None
) -> list[Row]:
    """A row for each method, range of touches, object and modality."""
    recording = scored.recording
    reference = other_objects_mean(recording) if reference is None else reference
    touches = recording.touches() if touches is None else touches
    rows: list[Row] = []
    for label, (low, high) in _RANGES.items():
        chosen = (touches >= low) & (touches <= high)
        if not chosen.any():
            continue
        errors = {method: _errors(recording, values, reference, chosen) for method, values in scored.counts.items()}
        for method, own in errors.items():
            own_skills = skills(own, settings.bootstrap)
            versus = compare(own, errors[MEMORY], settings.bootstrap) if method != MEMORY else None
            for modality in MODALITIES:
                one = own_skills[modality]
                row = {**_EMPTY, "method": method, "bin": label, "object": ALL_OBJECTS, "modality": modality}
                row |= {"skill": _rounded(one.value), "skill_low": _rounded(one.low), "skill_high": _rounded(one.high)}
                if versus is not None:
                    other = versus[modality]
                    row |= {
                        "vs_memory": _rounded(other.value),
                        "vs_memory_low": _rounded(other.low),
                        "vs_memory_high": _rounded(other.high),
                        "vs_memory_verdict": other.verdict,
                    }
                rows.append(row | _interval_columns(scored, method, modality, chosen))
                for name in own.objects if method in scored.half and label in _OBJECT_BINS else ():
                    mine = chosen & (recording.objects == name)
                    single = skills(own.only(name), settings.bootstrap)[modality].value
                    row = {**_EMPTY, "method": method, "bin": label, "object": name, "modality": modality}
                    rows.append(row | {"skill": _rounded(single)} | _interval_columns(scored, method, modality, mine))
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
    result |= {"coverage": _rounded(coverage), "half_width": round(float(half.mean()), 1)}
    if method != MEMORY:
        memory = scored.half[MEMORY][rows]
        scale = float(np.quantile(np.abs(readings - scored.counts[MEMORY][rows]) / memory, coverage))
        result["width_at_equal_coverage"] = _rounded(float(half.mean() / (scale * memory.mean())))
    return result


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(float(value), 4)


def summarise_prequential(rows: Sequence[Row]) -> list[Table]:
    """Tables of skill over touches, each object, intervals and jump, for each predictor by sight."""
    tables = []
    for sight in dict.fromkeys(row["sight"] for row in rows):
        own = [row for row in rows if row["sight"] == sight]
        tables.append(_skill_table(sight, own))
        tables.append(_object_table(sight, own))
        tables.append(_interval_table(sight, own))
        if any(row["bin"] == AFTER_JUMP for row in own):
            tables.append(_jump_table(sight, own))
    notes = [
        "skill: 0 is the mean of all readings of the other objects, earlier and later; the four numbers are PDC_TH, PDC_MF, E_TH, E_MF",
        "touches: of the object, since it was taken; an object that returns begins with 0",
        "▲ ▼: significantly better or worse than `memory` (95 % interval by bootstrap over objects)",
        "sight is fitted to all other objects, later ones included; past_mean uses earlier readings only (the parameters of the tracker do not)",
        "width: mean half width over that of `memory`, after the latter was scaled to the same coverage",
    ]
    return [*tables[:-1], replace(tables[-1], notes=notes)]


_SIGNS: Final = {"better": "▲", "worse": "▼"}


def _find(rows: Rows, **wanted: Any) -> list[Mapping[str, Any]]:
    return [row for row in rows if all(row[key] == value for key, value in wanted.items())]


def _present(rows: Rows, labels: Sequence[str]) -> list[str]:
    """Those ranges of touches that hold a grasp."""
    return [label for label in labels if any(row["bin"] == label for row in rows)]


def _four(rows: Rows, key: str, decimals: int = 2) -> str:
    return " ".join("–" if row[key] is None else f"{row[key]:.{decimals}f}" for row in rows)


def _skill_table(sight: str, rows: Rows) -> Table:
    body, labels = [], _present(rows, tuple(BINS))
    for method in dict.fromkeys(row["method"] for row in rows if row["bin"] in BINS):
        line = [method]
        for label in labels:
            cells = _find(rows, method=method, bin=label, object=ALL_OBJECTS)
            line.append(
                " ".join(f"{row['skill']:.2f}{_SIGNS.get(row['vs_memory_verdict'] or '', '')}" for row in cells)
            )
        body.append(line)
    count = {label: _find(rows, bin=label, object=ALL_OBJECTS)[0]["grasps"] for label in labels}
    return Table(f"{sight}: skill over touches", ["method", *(f"{label} ({count[label]})" for label in labels)], body)


def _object_table(sight: str, rows: Rows) -> Table:
    names = sorted({row["object"] for row in rows} - {ALL_OBJECTS})
    body = []
    for method in (TRACKER, MEMORY):
        for label in _present(rows, ("first 3", "3-9", "all")):  # a single grasp has no skill of its own
            parts = {name: _find(rows, method=method, bin=label, object=name) for name in names}
            cells = [_four(part, "skill") for part in parts.values()]
            worst = " ".join(
                f"{min(part[k]['skill'] for part in parts.values() if part):.2f}" for k in range(len(MODALITIES))
            )
            body.append([f"{method}, {label}", *cells, worst])
    return Table(f"{sight}: skill of each object", ["touches", *names, "worst"], body)


def _interval_table(sight: str, rows: Rows) -> Table:
    names = sorted({row["object"] for row in rows} - {ALL_OBJECTS})
    body = []
    for method in (TRACKER, MEMORY):
        for label in _present(rows, ("none", "first 3", "3-9", "10+", "all")):
            cells = _find(rows, method=method, bin=label, object=ALL_OBJECTS)
            body.append(
                [
                    f"{method}, {label}",
                    _four(cells, "coverage"),
                    _four(cells, "half_width", 0),
                    _four(cells, "width_at_equal_coverage"),
                ]
            )
        for name in names:
            later = _find(rows, method=method, bin=LATER, object=name)
            line = [f"{method}, {name} from the 4th grasp", _four(later, "coverage"), _four(later, "half_width", 0), ""]
            body += [line]
    return Table(f"{sight}: 90 % intervals", ["touches", "coverage", "half width [counts]", "width"], body)


def _jump_table(sight: str, rows: Rows) -> Table:
    jumps = _find(rows, bin=AFTER_JUMP)
    names = sorted({row["object"] for row in jumps})
    body = [
        [name, _four(_find(jumps, object=name), "coverage"), _four(_find(jumps, object=name), "noticed_after", 0)]
        for name in names
    ]
    means = [f"{np.mean([row['coverage'] for row in _find(jumps, modality=modality)]):.2f}" for modality in MODALITIES]
    body.append(["mean", " ".join(means), ""])
    title = f"{sight}: {_JUMP_GRASPS} grasps after a jump of all values"
    return Table(title, ["while touching", "coverage", "finger restarted after touches"], body)


def draw_prequential(rows: Rows, folder: Path) -> list[Path]:
    """Draw `touches.png`: skill over touches, with 95 % intervals of the first two; below it width and coverage."""
    sight = rows[0]["sight"]
    own = _find(rows, sight=sight)
    labels = _present(own, ("none", "1 touch", "2 touches", "3-9", "10+"))
    figure = new_figure(9.0, 4.8)
    above, below = figure.subplots(2, len(MODALITIES), sharex=True)
    shown = (TRACKER, MEMORY, "object mean", "clock", "running mean", SIGHT)
    for axes, modality in zip(above, MODALITIES, strict=True):
        for number, method in enumerate(shown):
            _draw_line(axes, _find(own, method=method, object=ALL_OBJECTS, modality=modality), labels, number, method)
        axes.set_title(modality)
        axes.axhline(0.0, color="grey", linewidth=0.8)
        axes.set_ylim(-0.6, 1.0)
    for axes, modality in zip(below, MODALITIES, strict=True):
        for number, method in enumerate((TRACKER, MEMORY)):
            cells = {row["bin"]: row for row in _find(own, method=method, object=ALL_OBJECTS, modality=modality)}
            axes.plot(
                range(len(labels)), [cells[k]["half_width"] for k in labels], "o-", color=f"C{number}", label=method
            )
            for x, k in enumerate(labels):
                axes.annotate(
                    f"{cells[k]['coverage']:.2f}",
                    (x, cells[k]["half_width"]),
                    (0, 6 if number else -13),
                    textcoords="offset points",
                    ha="center",
                    fontsize=8,
                    color=f"C{number}",
                )
        axes.set_ylim(bottom=0.0)
        axes.set_xlabel("touches of the object")
        axes.grid(visible=True, alpha=0.3)
    above[0].set_ylabel(f"skill (sight: {sight})")
    below[0].set_ylabel("half width [counts], coverage")
    figure.legend(*above[0].get_legend_handles_labels(), loc="outside lower center", ncols=len(shown), fontsize=9)
    return [save(figure, folder / "touches.png")]


def _draw_line(axes: Axes, rows: Rows, labels: Sequence[str], number: int, name: str) -> None:
    cells = {row["bin"]: row for row in rows}
    offset = 0.08 * (number - 2.5)
    x = np.arange(len(labels)) + offset
    axes.plot(x, [cells[label]["skill"] for label in labels], "o-", color=f"C{number}", markersize=4, label=name)
    for centre, label in zip(x, labels, strict=True):
        if name in (TRACKER, MEMORY) and cells[label]["skill_low"] is not None:
            ends = [cells[label]["skill_low"], cells[label]["skill_high"]]
            axes.plot([centre, centre], ends, color=f"C{number}", linewidth=0.8)
    axes.set_xticks(range(len(labels)), [label.split()[0] for label in labels])
    axes.grid(visible=True, alpha=0.3)
