# SPDX-License-Identifier: Apache-2.0
"""How much do the components of the contact model contribute, and how much a tare and touches?

On simulated objects that were never touched, with tares: predictions without adaptation, with a tare, after touches,
and with both, all scored on the same grasps. And the model without one of its components, compared with the full one:
on those objects, and on the real grasps in random folds, in blocks of time, on objects left out, and after touches of
these.

Variants of the estimator are tested before touches only, and those of the tracker after them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any, Final

import numpy as np

from foretouch.config import setting
from foretouch.experiments.ablation.variants import FULL, TRACKER_EDITS, ModelVariant, fit_variants
from foretouch.experiments.framework.experiment import Cell, Experiment, Row, Table
from foretouch.experiments.shared.figures import Line, draw_intervals, save_panels
from foretouch.experiments.shared.folds import touch_draws
from foretouch.experiments.shared.scores import error_rows, labelled, score_table
from foretouch.experiments.shared.simulated_data import (
    ConditionSettings,
    RealAndSimulated,
    load_both,
    prepare_both,
    split_condition,
)
from foretouch.experiments.shared.tables import (
    ALL_OBJECTS,
    SIGNS,
    SKILL_COLUMNS,
    findings,
    grouped,
    pivot,
    select,
    short,
    unique,
    with_notes,
)
from foretouch.learning.data import Indices, labels_of, make_folds
from foretouch.learning.evaluation.metrics import MEAN
from foretouch.report.panels import Rows
from foretouch.types import Float64, GraspSample

_NOTHING: Final = "nothing"
_SIMULATED: Final = "simulated"
_TITLES: Final = {
    _SIMULATED: "simulated new objects",
    "random": "real, random folds",
    "time": "real, blocks of time",
    "object": "real, new objects",
}
_COMPARED: Final = 3  # touches after which the variants are compared


@dataclass(frozen=True, kw_only=True)
class AblationSettings(ConditionSettings):
    """Settings of `ablation`."""

    test_conditions: tuple[str, ...] = setting(tuple(_TITLES), "Data and splits to test on", choices=tuple(_TITLES))
    seeds: tuple[int, ...] = setting(
        (0, 1, 2), "Seeds of the random folds, of the blocks of time and of their trees", minimum=0
    )
    touches: tuple[int, ...] = setting((1, 3, 5), "Numbers of touches of a test object", minimum=1, maximum=1000)


def _cells(settings: AblationSettings, data: RealAndSimulated) -> list[Cell]:
    real = labelled(data.real)
    return [
        Cell(f"{one}+{part}+seed{seed}".replace(" ", "_"), {"condition": one, "part": part, "seed": seed})
        for one in settings.test_conditions
        for part, seed in _parts(one, real, settings)
    ]


def _parts(condition: str, real: Sequence[GraspSample], settings: AblationSettings) -> Iterator[tuple[str, int]]:
    """Names of splits or folds, and seeds. Since calibration is slow, objects are left out with one seed only."""
    if condition == _SIMULATED:
        yield from ((str(split), settings.seeds[0]) for split in settings.split_seeds)
        return
    for seed in settings.seeds if condition != "object" else settings.seeds[:1]:
        yield from ((fold.name, seed) for fold in make_folds(real, condition, seed))


def _run(cell: Cell, settings: AblationSettings, data: RealAndSimulated) -> list[Row]:
    condition, part, seed = (cell.values[key] for key in ("condition", "part", "seed"))
    simulated, title = condition == _SIMULATED, _TITLES[condition]
    calibrated = simulated or condition == "object"
    train, test = split_condition(settings, data, "" if simulated else condition, part, seed)
    models = fit_variants(train, test, settings.contact.replace(seed=seed), calibrated=calibrated)
    score = partial(_rows, test, labels_of(train).mean(axis=0))
    rows: list[Row] = []
    every = np.arange(len(test))
    for name, model in models.items():
        if name not in TRACKER_EDITS:  # these only matter after touches
            rows += score(f"{title}, no touch", name, model, [(every[:0], every)])
    draws = _touch_draws(test, settings) if calibrated else []
    table = f"{title}, {'tare and ' if simulated else ''}{_COMPARED} touches"
    for name, model in models.items():
        if model.calibration is not None:
            rows += score(table, name, model, draws, _COMPARED, tare=simulated)
    for tare, count in product((False, True), (0, *settings.touches)) if simulated else ():
        touches = "" if not count else f"{count} touch{'es' if count > 1 else ''}"
        name = " + ".join(filter(None, ("tare" if tare else "", touches))) or _NOTHING
        rows += score(f"{title}, with tare and touches", name, models[FULL], draws, count, tare=tare)
    return rows


def _touch_draws(test: Sequence[GraspSample], settings: AblationSettings) -> list[tuple[Indices, Indices]]:
    """For each object and draw, grasps in the order in which they are touched, and those that are scored."""
    most = max(*settings.touches, _COMPARED)
    names = np.array([sample.object for sample in test])
    draws = []
    for name in np.unique(names):
        own = np.flatnonzero(names == name)
        orders = touch_draws(str(name), len(own), most, settings.draws)
        draws += [(own[order[:most]], own[order[most:]]) for order in orders]
    return draws


def _rows(
    test: Sequence[GraspSample],
    mean: Float64,
    table: str,
    name: str,
    model: ModelVariant,
    draws: Sequence[tuple[Indices, Indices]],
    count: int = 0,
    *,
    tare: bool = False,
) -> list[Row]:
    """`error_rows` of a variant after the first `count` touches of each draw."""
    predicted = np.concatenate([model.predict(index, touched[:count], tare=tare) for touched, index in draws])
    scored = [test[k] for _, index in draws for k in index]
    errors = error_rows(scored, predicted, labels_of(scored), mean)
    return [{"table": table, "predictor": name, **row} for row in errors]


def _tabulate(settings: AblationSettings, rows: Sequence[Row]) -> list[Row]:
    """Rows without those of single objects; errors on an object that several splits tested are added up."""
    result = []
    for _, own in grouped(rows, "table"):
        variants = unique(own, "predictor")
        reference = FULL if FULL in variants else _NOTHING
        for row in select(score_table(own, variants, [reference], settings.bootstrap), object=ALL_OBJECTS):
            versus = {name: row.pop(name) for name in list(row) if name.startswith("vs_")}
            renamed = {name.replace(f"vs_{reference}", "difference"): value for name, value in versus.items()}
            result.append({**row, "reference": reference, **renamed})
    return result


def _summarise(rows: Sequence[Row]) -> list[Table]:
    """A table for each condition: skill, and its difference from the full model or from no adaptation."""
    tables, sentences = [], []
    for name, own in grouped(rows, "table"):
        title = f"{name}: {own[0]['objects']} objects, compared with `{own[0]['reference']}`"
        tables.append(Table(title, SKILL_COLUMNS, pivot(own, "predictor", _cell, names=SKILL_COLUMNS[1:])))
        means = select(own, modality=MEAN)
        texts = [f"{r['predictor']} {short(r['skill'])}{SIGNS.get(r['difference_verdict'], '')}" for r in means]
        sentences.append(f"{name}: mean skill of {', '.join(texts)}")
    notes = [
        "skill: 0 is the mean of the training labels, 1 is perfect",
        "(difference from the reference [95 % interval by bootstrap over objects])",
        "▲ significantly better, ▼ significantly worse, = no significant difference",
    ]
    return [findings(sentences), *with_notes(tables, notes)]


def _cell(row: Row) -> str:
    if row["difference"] is None:
        return f"{row['skill']:.3f}"
    sign = SIGNS.get(row["difference_verdict"], "")
    low, high = row["difference_low"], row["difference_high"]
    interval = "" if low is None else f"\n[{low:+.3f}, {high:+.3f}]"
    return f"{row['skill']:.3f} ({row['difference']:+.3f} {sign}".rstrip() + f"{interval})"


def _draw(rows: Rows, folder: Path) -> list[Path]:
    """Draw `ablation.png`: differences from the reference, tables below each other, modalities side by side."""
    lines = []
    for name, own in grouped([row for row in rows if row["predictor"] != row["reference"]], "table"):
        variants = unique(own, "predictor")
        draw = partial(
            draw_intervals, column="predictor", names=variants, values="difference", lowest=-0.3, colour=_colour
        )
        label = f"skill difference from `{own[0]['reference']}`: green better, red worse (95 % interval)"
        lines.append(Line(0.9 + 0.22 * len(variants), own, draw, name, label))
    return save_panels(folder / "ablation.png", 15.0, lines, sharex="row", sharey="row")


def _colour(row: Mapping[str, Any]) -> str:
    return {"better": "C2", "worse": "C3"}.get(row["difference_verdict"], "grey")


EXPERIMENT = Experiment(
    name="ablation",
    question="How much do the components of the contact model contribute, and how much a tare and touches?",
    module=__name__,
    order=90,
    settings=AblationSettings,
    presets={
        "full": {"split_seeds": [0, 1]},
        "quick": {"split_seeds": [0, 1], "contact.trees": 50},
        "smoke": {
            "samples": 100,
            "train_objects": 50,
            "test_conditions": ["time"],
            "seeds": [0],
            "draws": 2,
            "contact.trees": 5,
            "bootstrap.draws": 200,
        },
    },
    load=load_both,
    cells=_cells,
    run=_run,
    tabulate=_tabulate,
    summarise=_summarise,
    figure=_draw,
    prepare=prepare_both,
    resumable_settings=("test_conditions", "seeds", "split_seeds", "bootstrap"),
    data_folder="vision2tactile",
)
