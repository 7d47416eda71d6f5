# SPDX-License-Identifier: Apache-2.0
"""Scores of what stands for where on the object, as rows, tables and a figure."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from foretouch.models.tracker import MISS_RATE
from foretouch.report.panels import Rows
from foretouch.types import Bool, Float64
from foretouch_lab.experiments.framework.experiment import Row, Table
from foretouch_lab.experiments.shared.figures import Line, draw_series, save_panels
from foretouch_lab.experiments.shared.scores import interval_columns
from foretouch_lab.experiments.shared.tables import (
    ALL_OBJECTS,
    SIGNS,
    findings,
    grouped,
    listed,
    select,
    short,
    with_notes,
)
from foretouch_lab.learning.evaluation.metrics import MEAN, BootstrapConfig, ObjectErrors, compare, skills

_LEVEL: Final = "level"
CEILING: Final = "ceiling"
REGIMES: Final[Mapping[str, tuple[int, int]]] = {"first three": (0, 2), "later": (3, 10**9)}
CURVE: Final[Mapping[str, tuple[int, int]]] = {
    f"{low}-{high}": (low, high) for low, high in ((0, 2), (3, 5), (6, 10), (11, 20), (21, 35), (36, 49))
}
"""Ranges of the number of touches of the object before a grasp, both ends included, by name."""

_COLUMNS: Final = (
    *("variant", "regime", "object", "modality", "grasps", "skill", "skill_low", "skill_high", "gain", "gain_low"),
    *("gain_high", "gain_verdict", "coverage", "half_width", "interval_score"),
)


def where_rows(cells: Sequence[Row], config: BootstrapConfig) -> list[Row]:
    """Rows of `results.csv`, of the rows of all cells."""
    played = dict(grouped(select(cells, what="predict"), "variant"))
    scores = {name: _Scores(rows) for name, rows in played.items()}
    rows: list[Row] = []
    for regime, (low, high) in {**REGIMES, **CURVE}.items():
        for name, scored in scores.items():
            if (chosen := scored.between(low, high)).any():
                rows += scored.rows(scores[_LEVEL], name, regime, chosen, config)
    if repeated := select(cells, what="repeat"):
        rows += scores[_LEVEL].ceiling(np.array([row["variance"] for row in repeated]))
    return [{name: row.get(name) for name in _COLUMNS} for row in rows]


class _Scores:
    """Predictions of all objects with one variant."""

    def __init__(self, rows: Sequence[Row]) -> None:
        own = [row for row in rows if row["touches"]]
        self.objects = np.repeat([row["object"] for row in own], [len(row["touches"]) for row in own]).astype(np.str_)
        self.touches = np.concatenate([row["touches"] for row in own])
        names = ("counts", "half", "readings", "reference")
        self.counts, self.half, self.readings, self.reference = (np.concatenate([row[k] for row in own]) for k in names)
        ends = np.cumsum([0, *rows[0]["modalities"].values()])
        self.columns = {name: slice(*ends[k : k + 2]) for k, name in enumerate(rows[0]["modalities"])}
        self._channels: Any = _Columns(self.columns)

    def between(self, low: int, high: int) -> Bool:
        """(S,) grasps with that many touches of their object before."""
        return (self.touches >= low) & (self.touches <= high)

    def errors(self, chosen: Bool) -> ObjectErrors:
        """Squared errors by object."""
        rows = (values[chosen] for values in (self.objects, self.counts, self.readings, self.reference))
        return ObjectErrors.of_predictions(*rows, self._channels)

    def rows(self, level: "_Scores", name: str, regime: str, chosen: Bool, config: BootstrapConfig) -> list[Row]:
        """A row for each modality and their mean, and for each object in the regimes."""
        errors, before = self.errors(chosen), level.errors(chosen)
        found, gains = skills(errors, config), compare(errors, before, config)
        rows: list[Row] = []
        for modality in (*self.columns, MEAN):
            place: Row = {"variant": name, "regime": regime, "object": ALL_OBJECTS, "modality": modality}
            place |= interval_columns("skill", found[modality])
            if name != _LEVEL:
                place |= interval_columns("gain", gains[modality]) | {"gain_verdict": gains[modality].verdict}
            rows.append(place | self._intervals(modality, chosen))
        for one in errors.objects if regime in REGIMES else ():
            skill, gain = skills(errors.only(one), config), compare(errors.only(one), before.only(one), config)
            for modality in (*self.columns, MEAN):
                row = {"variant": name, "regime": regime, "object": one, "modality": modality}
                row |= {"skill": skill[modality].value, "gain": gain[modality].value}
                rows.append(row | self._intervals(modality, chosen & (self.objects == one)))
        return rows

    def _intervals(self, modality: str, chosen: Bool) -> Row:
        """Coverage, half width and interval score of the 90 % intervals [Gneiting and Raftery 2007, eq. 43]."""
        if modality == MEAN:
            return {"grasps": int(chosen.sum())}
        own = np.s_[chosen, self.columns[modality]]
        half = self.half[own]
        beyond = np.abs(self.readings[own] - self.counts[own]) - half
        score = 2.0 * half + 2.0 / MISS_RATE * np.maximum(beyond, 0.0)
        found = {"coverage": (beyond <= 0.0).mean(), "half_width": half.mean(), "interval_score": score.mean()}
        return {"grasps": int(chosen.sum()), **{key: float(value) for key, value in found.items()}}

    def ceiling(self, variances: Float64) -> list[Row]:
        """Skill of a predictor whose errors are the (R, D) variances of grasps that are executed again."""
        later = self.between(*REGIMES["later"])
        share = 1.0 - variances.mean(axis=0) / ((self.readings - self.reference)[later] ** 2).mean(axis=0)
        by_name = {name: float(share[own].mean()) for name, own in self.columns.items()}
        by_name[MEAN] = float(np.mean(list(by_name.values())))
        place: Row = {"variant": CEILING, "regime": "later", "object": ALL_OBJECTS, "grasps": len(variances)}
        return [{**place, "modality": name, "skill": skill} for name, skill in by_name.items()]


class _Columns:
    """What `metrics` reads of the channels of a sensor."""

    def __init__(self, columns: Mapping[str, slice]) -> None:
        self.modality_columns = {name: np.arange(own.start, own.stop) for name, own in columns.items()}
        self.modalities = tuple(columns)
        self.size = max(own.stop for own in columns.values())


def summarise_where(rows: Sequence[Row]) -> list[Table]:
    """Skills and gains, intervals, the curve over touches, and each object."""
    together = select(rows, object=ALL_OBJECTS)
    modalities = [name for name in dict.fromkeys(row["modality"] for row in rows) if name != MEAN]
    names = [*modalities, MEAN]
    tables = [findings(_sentences(together))]
    for regime in REGIMES:
        own = select(together, regime=regime)
        body = [[name, *(_cell(row) for row in part)] for name, part in grouped(own, "variant")]
        tables.append(Table(f"{regime}: {own[0]['grasps']} grasps", ["where", *names], body))
    curve = [row for row in together if row["regime"] in CURVE and row["variant"] in ("level", "where", "shuffled")]
    body = [
        [regime, name, *(_cell(row) for row in part)] for (regime, name), part in grouped(curve, "regime", "variant")
    ]
    tables.append(Table("Over touches of the object", ["touches", "where", *names], body))
    scored = [row for row in together if row["regime"] in REGIMES and row["coverage"] is not None]
    body = [
        [f"{regime}, {name}", *(_numbers(part, key) for key in ("coverage", "half_width", "interval_score"))]
        for (regime, name), part in grouped(scored, "regime", "variant")
    ]
    tables.append(Table("90 % intervals", ["where", "coverage", "half width", "score"], body))
    single = [row for row in select(rows, regime="later", variant="where") if row["object"] != ALL_OBJECTS]
    body = [
        [name, listed(part, "gain"), _numbers([row for row in part if row["coverage"] is not None], "coverage")]
        for name, part in grouped(single, "object")
    ]
    tables.append(Table("Each object, later, with where", ["object", "gain", "coverage"], body))
    notes = [
        f"{', '.join(names)}; skill: 0 is the mean of all readings of the other objects, 1 is perfect; gain: skill minus that of level",
        "[95 % interval of the gain by bootstrap over objects]; ▲ ▼ =: significantly better, worse or not different from level",
        "first three: grasps before which the object was touched at most twice; later: all others",
        "interval score: width, plus 20 times the distance of readings outside; the lower the better",
    ]
    return with_notes(tables, notes)


def _sentences(rows: Sequence[Row]) -> list[str]:
    found = []
    for regime in REGIMES:
        own = dict(grouped(select(rows, regime=regime), "variant"))
        level, where = own["level"], own["where"]
        better = [row["modality"] for row in where if row["gain_verdict"] == "better"]
        found.append(
            f"{regime}: {listed(level, 'skill')} without where, {listed(where, 'skill')} with it; gain {listed(where, 'gain')}, "
            f"significant in {', '.join(better) or 'none'}"
        )
        if CEILING in own:
            found.append(f"ceiling, later: {listed(own[CEILING], 'skill')}")
    curve = [row for row in select(rows, variant="where", modality=MEAN) if row["regime"] in CURVE]
    found.append("mean gain over touches: " + ", ".join(f"{row['regime']}: {_gain(row)}" for row in curve))
    return found


def _gain(row: Mapping[str, Any]) -> str:
    ends = "" if row["gain_low"] is None else f" [{row['gain_low']:+.3f}, {row['gain_high']:+.3f}]"
    return f"{row['gain']:+.3f}{ends}"


def _cell(row: Mapping[str, Any]) -> str:
    if row["gain"] is None:
        return short(row["skill"])
    return f"{short(row['skill'])} {SIGNS.get(row['gain_verdict'], '')} {_gain(row)}"


def _numbers(rows: Sequence[Mapping[str, Any]], column: str) -> str:
    digits = 2 if column == "coverage" else 0
    return " ".join(f"{row[column]:.{digits}f}" for row in rows)


def draw_where(rows: Rows, folder: Path) -> list[Path]:
    """Draw `touches.png`: skill over the number of touches before, without and with where, and the ceiling."""
    together = select(rows, object=ALL_OBJECTS)
    curve = [row for row in together if row["regime"] in CURVE]
    modalities = list(dict.fromkeys(row["modality"] for row in curve))
    ceilings = {row["modality"]: row["skill"] for row in select(together, variant=CEILING)}
    plain = [{**row, "skill_low": None} for row in curve]
    largest = max((row["gain"] for row in curve if row["gain"] is not None), default=0.0)

    def draw(axes: Any, own: Rows) -> None:
        draw_series(axes, own, "regime", "variant", ["level", "where", "shuffled"], places=list(CURVE))
        if own and own[0]["modality"] in ceilings:
            axes.axhline(ceilings[own[0]["modality"]], color="black", linestyle="--", linewidth=0.9, label="ceiling")

    def gain(axes: Any, own: Rows) -> None:
        names = ["", "where", "shuffled"]  # in the colours of the line above
        draw_series(axes, own, "regime", "variant", names, values="gain", places=list(CURVE), spread=0.15)
        axes.tick_params("x", rotation=45, labelsize=8)
        axes.set_ylim(-0.15, max(0.2, 1.1 * largest))

    lines = [
        Line(2.6, plain, draw, "", "", "skill", "right upper"),
        Line(2.6, [row for row in curve if row["gain"] is not None], gain, "", "touches of the object before", "gain"),
    ]
    return save_panels(
        folder / "touches.png", 2.4 * len(modalities), lines, modalities=modalities, sharex=True, sharey="row"
    )
