# SPDX-License-Identifier: Apache-2.0
"""Scores of the replay over touches of the object, as rows, tables and figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from foretouch.experiments.framework.experiment import Row, Table
from foretouch.experiments.shared.figures import draw_series, legend_of, modality_panels
from foretouch.experiments.shared.rows import SIGNS, grouped, listed, select, short, unique
from foretouch.experiments.shared.scores import ALL_OBJECTS, interval_columns
from foretouch.experiments.shared.skill_tables import findings
from foretouch.learning.evaluation.metrics import BootstrapConfig, ObjectErrors, compare, skills
from foretouch.learning.evaluation.prequential import BINS, Recording, baselines, other_objects_mean, replay
from foretouch.learning.training.calibration import HeldOutPredictions, fit_group
from foretouch.learning.training.tracker import fit_tracker
from foretouch.models.calibration import Calibration
from foretouch.models.state_space import FINGERS, TrackerParameters
from foretouch.models.tracker import SensorTracker
from foretouch.report.panels import Rows, save
from foretouch.tactile import FULL_SCALE, MODALITIES, columns
from foretouch.types import TOUCH_SIZE, Float64

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
                    played = replay(SensorTracker(parameters), _with_past_mean(recording, int(run)), keep_sensors=keep)
                    last = runs[runs <= run] == run
                    strict.add(method, runs == run, played.counts[last], played.half[last])
        others_mean = other_objects_mean(recording)
        for method, values in ({VISION: recording.expected} | baselines(recording, others_mean)).items():
            whole.add(method, own, values[own])
        jumps += _jump_rows(name, recording, fitted[TRACKER])
    rows = [{VISION: predictor, **row} for row in [*_score_rows(whole, config), *jumps]]
    rows += [{VISION: PAST, **row} for row in _score_rows(strict, config)] if past else []
    return [{name: row.get(name) for name in _COLUMNS} for row in rows]


def _with_past_mean(recording: Recording, run: int) -> Recording:
    """A recording up to the end of a run of grasps, with the mean of all readings before that run as prediction."""
    runs = recording.runs()
    past, shown = runs < run, recording.take(runs <= run)
    if shown.tares is not None and recording.tares is not None:
        known = np.isfinite(recording.tares[past]).all(axis=1)
        level = recording.tares[past][known].mean(axis=0) if known.any() else np.nan
        shown = replace(shown, tares=shown.tares - level)
    mean = recording.readings[past].mean(axis=0)
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
        sentences += _sentences(vision, own)
        tables += [_skill_table(vision, own), _object_table(vision, own), _interval_table(vision, own)]
        if any(row["bin"] == AFTER_JUMP for row in own):
            tables.append(_jump_table(vision, own))
    notes = [
        "skill: 0 is the mean of all readings of the other objects, earlier and later; the four numbers are PDC_TH, PDC_MF, E_TH, E_MF",
        "touches: of the object, since it was taken; an object that returns begins with 0",
        f"▲ ▼: significantly better or worse than `{MEMORY}`, a tracker that ends with the object (95 % interval by bootstrap over objects)",
        f"vision is fitted to all other objects, later ones included; `{PAST}` uses earlier readings only (the parameters of tracker and memory do not)",
        f"width: mean half width over that of `{MEMORY}`, after the latter was scaled to the same coverage",
    ]
    return [findings(sentences), *tables[:-1], replace(tables[-1], notes=notes)]


def _sentences(vision: str, rows: Rows) -> list[str]:
    """Skills and coverage of the tracker."""
    together = select(rows, method=TRACKER, object=ALL_OBJECTS)
    before, first, every = (listed(select(together, bin=label), "skill") for label in ("none", "first 3", "all"))
    coverage = listed(select(together, bin="all"), "coverage")
    before = f"{before} before the first touch of an object, " if before else ""
    found = [f"{vision}: the tracker has skills of {before}{first} on its first three grasps, {every} on all"]
    later = [row["coverage"] for row in select(rows, method=TRACKER, bin=LATER) if row["object"] != ALL_OBJECTS]
    jumps = [row["coverage"] for row in select(rows, bin=AFTER_JUMP)]
    text = f"{vision}: its 90 % intervals cover {coverage}"
    text += f", of each object from its fourth grasp at least {short(min(later))}" if later else ""
    if jumps:
        text += (
            f", and after a jump of all values {short(float(np.mean(jumps)))} on average, at least {short(min(jumps))}"
        )
    return [*found, text]


def _present(rows: Rows, labels: Sequence[str]) -> list[str]:
    """Those ranges of touches that hold a grasp."""
    return [label for label in labels if any(row["bin"] == label for row in rows)]


def _skill_table(vision: str, rows: Rows) -> Table:
    together = [row for row in select(rows, object=ALL_OBJECTS) if row["bin"] in BINS]
    labels = _present(rows, tuple(BINS))
    signs = {name: sign for name, sign in SIGNS.items() if name != "tie"}
    body = []
    for method, own in grouped(together, "method"):
        found = {
            label: " ".join(f"{row['skill']:.2f}{signs.get(row['vs_memory_verdict'], '')}" for row in cells)
            for label, cells in grouped(own, "bin")
        }
        body.append([method, *(found[label] for label in labels)])
    count = {label: select(together, bin=label)[0]["grasps"] for label in labels}
    return Table(f"{vision}: skill over touches", ["method", *(f"{label} ({count[label]})" for label in labels)], body)


def _object_table(vision: str, rows: Rows) -> Table:
    names = sorted(set(unique(rows, "object")) - {ALL_OBJECTS})
    body = []
    for method in (TRACKER, MEMORY):
        for label in _present(rows, ("first 3", "3-9", "all")):  # a single grasp has no skill of its own
            own = select(rows, method=method, bin=label)
            parts = [select(own, object=name) for name in names]
            cells = [_four(part, "skill") for part in parts]
            worst = (min(part[k]["skill"] for part in parts if part) for k in range(len(MODALITIES)))
            body.append([f"{method}, {label}", *cells, " ".join(f"{one:.2f}" for one in worst)])
    return Table(f"{vision}: skill of each object", ["touches", *names, "worst"], body)


def _interval_table(vision: str, rows: Rows) -> Table:
    body = []
    for method in (TRACKER, MEMORY):
        own = select(rows, method=method)
        for label in _present(rows, ("none", "first 3", "3-9", "10+", "all")):
            cells = select(own, bin=label, object=ALL_OBJECTS)
            width = _four(cells, "width_at_equal_coverage")
            body.append([f"{method}, {label}", _four(cells, "coverage"), _four(cells, "half_width", 0), width])
        for name, later in grouped(select(own, bin=LATER), "object"):
            line = [f"{method}, {name} from the 4th grasp", _four(later, "coverage"), _four(later, "half_width", 0), ""]
            body += [line] * (name != ALL_OBJECTS)
    return Table(f"{vision}: 90 % intervals", ["touches", "coverage", "half width [counts]", "width"], body)


def _jump_table(vision: str, rows: Rows) -> Table:
    jumps = select(rows, bin=AFTER_JUMP)
    found = sorted(grouped(jumps, "object"))
    body = [[name, _four(own, "coverage"), _four(own, "noticed_after", 0)] for name, own in found]
    means = [f"{np.mean([row['coverage'] for row in select(jumps, modality=name)]):.2f}" for name in MODALITIES]
    title = f"{vision}: {_JUMP_GRASPS} grasps after a jump of all values"
    columns_ = ["while touching", "coverage", "finger restarted after touches"]
    return Table(title, columns_, [*body, ["mean", " ".join(means), ""]])


def _four(rows: Rows, key: str, decimals: int = 2) -> str:
    return " ".join("–" if row[key] is None else f"{row[key]:.{decimals}f}" for row in rows)


def draw_prequential(rows: Rows, folder: Path) -> list[Path]:
    """Draw `touches.png`: skill over touches, with 95 % intervals; below it width and coverage."""
    vision = rows[0][VISION]
    together = select(rows, vision=vision, object=ALL_OBJECTS)
    labels = _present(together, ("none", "1 touch", "2 touches", "3-9", "10+"))
    shown = (TRACKER, MEMORY, "object mean", "clock", "running mean", VISION)
    figure, (above, below) = modality_panels(9.0, (2.4, 2.4), sharex=True)
    for axes, modality in above:
        own = [row for row in select(together, modality=modality) if row["bin"] in labels]
        # Intervals of the first two alone: six would hide each other.
        own = [row if row["method"] in (TRACKER, MEMORY) else {**row, "skill_low": None} for row in own]
        draw_series(axes, own, "bin", "method", shown, places=labels, spread=0.08)
        axes.set_ylim(-0.6, 1.0)
    for axes, modality in below:
        own = [
            row for row in select(together, modality=modality) if row["bin"] in labels and row["coverage"] is not None
        ]
        draw_series(axes, own, "bin", "method", (TRACKER, MEMORY), values="half_width", places=labels)
        for row in own:
            number = (TRACKER, MEMORY).index(row["method"])
            how: dict[str, Any] = {"ha": "center", "fontsize": 8, "color": f"C{number}", "textcoords": "offset points"}
            axes.annotate(
                f"{row['coverage']:.2f}",
                (labels.index(row["bin"]), row["half_width"]),
                (0, 6 if number else -13),
                **how,
            )
        axes.set_xticks(range(len(labels)), [label.split()[0] for label in labels])
        axes.set_ylim(bottom=0.0)
        axes.set_xlabel("touches of the object")
    above[0][0].set_ylabel(f"skill (vision: {vision})")
    below[0][0].set_ylabel("half width [counts], coverage")
    legend_of(figure, above[0][0], "lower center", ncols=len(shown))
    return [save(figure, folder / "touches.png")]
