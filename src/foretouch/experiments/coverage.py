# SPDX-License-Identifier: Apache-2.0
"""Do the 90 % intervals of the contact model cover 90 % of the readings on objects that were never touched?

    simulated      some objects of a scene for training and calibration, the others for testing; several random splits
    left out       each real object left out once, of training and of calibration
    time blocks    known real objects, at a time that is left out of training and of calibration

An object is tested without a touch and after some, with a tare and without where there are tares. The predictor is the
released one, `ContactPredictor`, which is calibrated on its training samples alone.

Coverage is counted value by value and averaged over the values of a modality, the grasps and the draws of touches.
Width is relative to the interval around the mean of the training labels, calibrated by the same rule.

Intervals of a mean are by bootstrap over objects with expanded percentiles, as everywhere
(`learning.evaluation.metrics`).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from foretouch.config import setting
from foretouch.experiments.framework.experiment import Cell, Experiment, Row, Table
from foretouch.experiments.shared.figures import draw_series
from foretouch.experiments.shared.folds import by_object, touch_draws
from foretouch.experiments.shared.scores import labelled
from foretouch.experiments.shared.simulated_data import (
    ConditionSettings,
    RealAndSimulated,
    load_both,
    prepare_both,
    split_condition,
)
from foretouch.experiments.shared.tables import ALL_OBJECTS, findings, grouped, pivot, select, short, span, with_notes
from foretouch.learning.data import labels_of, make_folds, object_folds
from foretouch.learning.evaluation.metrics import BootstrapConfig, mean_over_objects
from foretouch.learning.training.calibration import HeldOutPredictions, fit_group
from foretouch.learning.training.contact import ContactPredictor
from foretouch.report.panels import Axes, Rows, new_figure, save_small
from foretouch.tactile import MODALITIES, columns
from foretouch.types import Float64, GraspSample

_SIMULATED: Final = "simulated"
_TIME: Final = "time blocks"
_SPLITS: Final = {_SIMULATED: "", "left out": "object", _TIME: "time"}
_NOMINAL: Final = 0.9
_ACCEPTED: Final = (0.85, 0.95)  # range in which the mean coverage must lie
_CONDITION: Final = ("condition", "tare", "touches")


@dataclass(frozen=True, kw_only=True)
class CoverageSettings(ConditionSettings):
    """Settings of `coverage`."""

    test_conditions: tuple[str, ...] = setting(tuple(_SPLITS), "Data and splits to test on", choices=tuple(_SPLITS))
    touches: tuple[int, ...] = setting((0, 1, 3, 5), "Numbers of touches of a test object", minimum=0, maximum=1000)


def _cells(settings: CoverageSettings, data: RealAndSimulated) -> list[Cell]:
    cells = []
    for condition in settings.test_conditions:
        if condition == _SIMULATED:
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


def coverage_table(rows: Sequence[Row], config: BootstrapConfig) -> list[Row]:
    """Rows of `results.csv`, one per modality: for all objects of a condition together, then for each object.

    Args:
        rows: Rows of `coverage_rows` with `condition` and `part`. An object of several parts counts once, by its mean.
        config: Configuration of the bootstrap.
    """
    result: list[Row] = []
    for condition, chosen in grouped(rows, *_CONDITION):
        head = dict(zip(_CONDITION, condition, strict=True))
        means = {name: _mean_of(own) for name, own in sorted(grouped(chosen, "object"))}
        for name, own in {ALL_OBJECTS: list(means.values()), **{name: [one] for name, one in means.items()}}.items():
            counts = {"objects": len(own), "grasps": sum(one["grasps"] for one in own)}
            flagged = np.mean([one["unfamiliar"] for one in own])
            for k, modality in enumerate(MODALITIES):
                coverage = mean_over_objects(np.array([one["coverage"][k] for one in own]), config)
                found = {"coverage": coverage.value, "low": coverage.low, "high": coverage.high}
                found |= {"width": np.mean([one["width"][k] for one in own]), "unfamiliar": flagged}
                result.append({**head, "object": name, "modality": modality, **counts, **found})
    return result


def _mean_of(rows: Sequence[Row]) -> Row:
    """Means of one object's rows; random splits of simulated objects repeat its grasps, other parts have their own."""
    means: Row = {name: np.mean([row[name] for row in rows], axis=0) for name in ("coverage", "width", "unfamiliar")}
    count = max if rows[0]["condition"] == _SIMULATED else sum
    return {**means, "grasps": count(row["grasps"] for row in rows)}


def _summarise(rows: Sequence[Row]) -> list[Table]:
    """A table of coverage and width for each condition, and one of the coverage of each real object."""
    sentences, tables, single_tables = [], [], []
    for condition, own in grouped(rows, "condition"):
        together = [{**row, "line": _label(row)} for row in select(own, object=ALL_OBJECTS)]
        title = f"{condition}: {together[0]['objects']} objects, {_percent(together[0])} of grasps flagged"
        tables.append(Table(title, ["coverage / width", *MODALITIES], pivot(together, "line", _cell)))
        single = [row for row in own if row["object"] != ALL_OBJECTS]
        lowest = min(single, key=lambda row: row["coverage"])
        sentences.append(
            f"{condition}: coverage is {span(row['coverage'] for row in together)} on average; the lowest of one object is "
            f"{short(lowest['coverage'])} ({lowest['object']}, {lowest['modality']}, {_label(lowest)})"
        )
        if condition != _SIMULATED:
            untouched = select(single, touches=0)
            flagged = [_percent(found[0]) for _, found in grouped(untouched, "object")]
            body = [
                [*line, one]
                for line, one in zip(
                    pivot(untouched, "object", lambda row: f"{row['coverage']:.2f}"), flagged, strict=True
                )
            ]
            single_tables.append(
                Table(f"{condition}, no touch: each object", ["coverage", *MODALITIES, "flagged"], body)
            )
    notes = [
        "mean over objects [95 % interval over objects] / interval width relative to that of the calibrated label mean",
        f"☒: the mean lies outside {_ACCEPTED[0]:.2f} to {_ACCEPTED[1]:.2f}",
    ]
    return [findings(sentences), *with_notes([*tables, *single_tables], notes)]


def _label(row: Row) -> str:
    touched = {0: "no touch", 1: "1 touch"}.get(row["touches"], f"{row['touches']} touches")
    return f"tare, {touched}" if row["tare"] else touched


def _percent(row: Row) -> str:
    return f"{100.0 * row['unfamiliar']:.0f} %"


def _cell(row: Row) -> str:
    sign = "" if _ACCEPTED[0] <= row["coverage"] <= _ACCEPTED[1] else " ☒"
    ends = "" if row["low"] is None else f" [{row['low']:.2f}, {row['high']:.2f}]"
    return f"{row['coverage']:.3f}{sign}{ends} / {row['width']:.2f}"


def _draw(rows: Rows, folder: Path) -> list[Path]:
    """Draw `coverage.png`: a line of panels for each condition, with and without tare: modalities, then widths."""
    conditions = grouped(rows, "condition", "tare")
    figure = new_figure(16.0, 0.6 + 2.5 * len(conditions))
    grid = figure.subplots(len(conditions), len(MODALITIES) + 1, squeeze=False)
    for line, ((condition, tare), own) in zip(grid, conditions, strict=True):
        for axes, modality in zip(line, MODALITIES, strict=False):
            _draw_coverage(axes, select(own, modality=modality))
            axes.set_title(modality, fontsize=10)
        line[0].set_ylabel(f"{condition}{', tare' if tare else ''}\ncoverage")
        together = select(own, object=ALL_OBJECTS)
        draw_series(line[-1], together, "touches", "modality", MODALITIES, values="width")
        line[-1].axhline(1.0, color="grey", linewidth=0.8)
        line[-1].set_ylim(0.0, max(1.1, *(1.05 * row["width"] for row in together)))
        line[-1].set_title("width relative to label-mean interval", fontsize=10)
    for axes in grid[-1]:
        axes.set_xlabel("touches")
    grid[0, -1].legend(fontsize=7, loc="lower left")
    return [save_small(figure, folder / "coverage.png")]


def _draw_coverage(axes: Axes, rows: Rows) -> None:
    """Draw one modality over touches: a dot per object, the mean with its interval, and the accepted range."""
    axes.axhspan(*_ACCEPTED, color="C2", alpha=0.15)
    axes.axhline(_NOMINAL, color="C2", linewidth=1.0)
    counts = sorted(grouped(rows, "touches"))
    for x, (_, own) in enumerate(counts):
        dots = sorted(row["coverage"] for row in own if row["object"] != ALL_OBJECTS)
        spread = [x - 0.3 + 0.4 * k / max(len(dots) - 1, 1) for k in range(len(dots))]
        axes.plot(spread, dots, ".C0", markersize=4, alpha=0.6)
        (mean,) = select(own, object=ALL_OBJECTS)
        axes.plot(x + 0.25, mean["coverage"], "ok", markersize=5)
        if mean["low"] is not None:
            axes.plot([x + 0.25] * 2, [mean["low"], mean["high"]], color="k")
    axes.set_ylim(min(0.4, *(row["coverage"] for row in rows)) - 0.02, 1.02)
    axes.set_xlim(-0.5, len(counts) - 0.5)
    axes.set_xticks(range(len(counts)), [str(count) for count, _ in counts])
    axes.grid(visible=True, axis="y", alpha=0.3)


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
            "test_conditions": [_SIMULATED],
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
    summarise=_summarise,
    figure=_draw,
    prepare=prepare_both,
    resumable_settings=("test_conditions", "split_seeds", "bootstrap"),
    data_folder="vision2tactile",
)
