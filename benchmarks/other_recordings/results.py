# SPDX-License-Identifier: Apache-2.0
"""Scores of what is learnt without a camera, as rows and tables."""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from foretouch.types import Bool, Float64
from foretouch_lab.experiments.framework.experiment import Row, Table
from foretouch_lab.experiments.shared.tables import grouped, select
from foretouch_lab.learning.evaluation.metrics import BootstrapConfig

BINS: Final = 15
_BASELINE: Final = {"next": "last", "level": "mean of all"}
_COLUMNS: Final = (
    "what",
    "left_out",
    "method",
    "modality",
    "grasps",
    "objects",
    "score",
    "score_low",
    "score_high",
    "slip_first",
    "slip_first_low",
    "slip_first_high",
    "slip_first_pairs",
    "rmse",
    "calibration_error",
)


def auc(chance: Float64, held: Bool) -> float:
    """Probability that a grasp that held has the higher chance than one that did not; equal ones count half. NaN without both."""
    wins, pairs = _pairs(chance, held, np.zeros(len(held)))
    return float(wins.sum() / pairs.sum()) if pairs.sum() else float("nan")


def _pairs(chance: Float64, held: Bool, objects: Any) -> tuple[Float64, Float64]:
    """(O, O) won and all comparisons of the grasps on an object that held with those on another one that did not."""
    names = np.unique(objects)
    yes = [np.sort(chance[held & (objects == name)]) for name in names]
    no = [np.sort(chance[~held & (objects == name)]) for name in names]
    wins = [[(b.searchsorted(a, "left").sum() + b.searchsorted(a, "right").sum()) / 2.0 for b in no] for a in yes]
    return np.array(wins), np.outer([len(a) for a in yes], [len(b) for b in no]).astype(np.float64)


def slip_first(chance: Float64, held: Bool, sessions: Any) -> tuple[Float64, Float64]:
    """(N,) won and all comparisons of each session of a grasp that held with one that did not and came before it, in the order of the rows."""
    won, pairs = [], []
    for name in np.unique(sessions):
        own, yes = chance[sessions == name], held[sessions == name]
        later = np.tri(len(own), k=-1, dtype=bool) & yes[:, None] & ~yes
        won.append(((own[:, None] > own) + 0.5 * (own[:, None] == own))[later].sum())
        pairs.append(later.sum())
    return np.array(won, np.float64), np.array(pairs, np.float64)


def calibration_error(chance: Float64, held: Bool, bins: int = BINS) -> float:
    """Mean difference of predicted and observed share over bins of equal width, weighted by their grasps."""
    place = np.minimum((chance * bins).astype(int), bins - 1)
    parts = [(place == k) for k in range(bins)]
    return float(sum(abs(chance[part].sum() - held[part].sum()) for part in parts if part.any()) / len(chance))


def _draws(objects: int, config: BootstrapConfig) -> Float64:
    """(draws, O) how often each object is in a resample."""
    return (
        np.random.default_rng(config.seed)
        .multinomial(objects, np.full(objects, 1.0 / objects), config.draws)
        .astype(np.float64)
    )


def _interval(scores: Float64, name: str = "score") -> dict[str, float]:
    low, high = np.nanpercentile(scores, [2.5, 97.5])
    return {f"{name}_low": float(low), f"{name}_high": float(high)}


def tabulate(rows: Sequence[Row], config: BootstrapConfig) -> list[Row]:
    """Rows of `results.csv`, of the rows of all cells."""
    found: list[Row] = []
    hold = select(rows, what="hold")
    for (left_out, method), parts in grouped(hold, "left_out", "method"):
        chance, held, objects, sessions = (
            np.concatenate([np.array(part[key]) for part in parts]) for key in ("chance", "held", "objects", "sessions")
        )
        wins, pairs = _pairs(chance, held, objects)
        drawn = _draws(len(wins), config)
        interval = _interval(
            np.einsum("no,op,np->n", drawn, wins, drawn, optimize=True)
            / np.einsum("no,op,np->n", drawn, pairs, drawn, optimize=True)
        )
        facts = {"grasps": len(held), "objects": len(np.unique(objects)), "score": auc(chance, held)}
        facts["calibration_error"] = calibration_error(chance, held)
        won, against = slip_first(chance, held, sessions)
        if against.any():
            drawn = _draws(len(won), config)
            first = {
                "slip_first": won.sum() / against.sum(),
                **_interval(drawn @ won / (drawn @ against), "slip_first"),
            }
            facts |= {**first, "slip_first_pairs": int(against.sum())}
        found.append({"what": "hold", "left_out": left_out, "method": method, **facts, **interval})
    for what, baseline in _BASELINE.items():
        for modality, parts in grouped(select(rows, what=what), "modality"):
            objects = np.array(sorted({part["left_out"] for part in parts}))
            for method, own in grouped(parts, "method"):
                sums = {part["left_out"]: part for part in own}
                base = {part["left_out"]: part for part in select(parts, method=baseline)}
                squares, against, counts = (
                    np.array([each[name][key] for name in objects], np.float64)
                    for each, key in ((sums, "squares"), (base, "squares"), (sums, "count"))
                )
                drawn = _draws(len(objects), config)
                interval = _interval(1.0 - drawn @ squares / (drawn @ against))
                facts = {"objects": len(objects), "score": 1.0 - squares.sum() / against.sum(), **interval}
                rmse = float(np.sqrt(squares.sum() / counts.sum()))
                found.append(
                    {"what": what, "left_out": "objects", "method": method, "modality": modality, **facts, "rmse": rmse}
                )
    return [{name: row.get(name) for name in _COLUMNS} for row in found]


def summarise(rows: Sequence[Row]) -> list[Table]:
    """A table for each question."""
    tables = []
    for left_out, parts in grouped(select(rows, what="hold"), "left_out"):
        lines = [
            [
                str(row["method"]),
                _between(row),
                "" if row["slip_first"] in (None, "") else _between(row, "slip_first"),
                f"{float(row['calibration_error']):.3f}",
            ]
            for row in parts
        ]
        head = f"will it hold, {left_out} left out: {parts[0]['grasps']} grasps, {parts[0]['objects']} objects"
        columns = ("method", "AUC", "AUC, slip before stable", f"calibration error, {BINS} bins")
        pairs = f"; of {parts[0]['slip_first_pairs']} pairs of a session with the slip before the stable grasp, over sessions"
        tables.append(Table(head, columns, lines, [_NOTE + pairs * bool(parts[0]["slip_first_pairs"])]))
    for what, baseline in _BASELINE.items():
        for modality, parts in grouped(select(rows, what=what), "modality"):
            lines = [[str(row["method"]), f"{float(row['rmse']):.3g}", _between(row)] for row in parts]
            head = {"next": "next reading in contact", "level": "touch of the next grasp"}[what]
            note = f"skill: 1 - MSE / MSE of `{baseline}`; {_NOTE}"
            tables.append(Table(f"{head}, {modality}", ("method", "RMSE", "skill"), lines, [note]))
    return tables


_NOTE: Final = "[95 % interval by bootstrap over objects]"


def _between(row: Row, name: str = "score") -> str:
    return f"{float(row[name]):.3f} [{float(row[f'{name}_low']):.3f}, {float(row[f'{name}_high']):.3f}]"
