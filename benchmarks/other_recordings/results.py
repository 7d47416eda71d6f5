# SPDX-License-Identifier: Apache-2.0
"""Scores of predictions whether a grasp holds, as rows and tables."""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from sklearn.metrics import roc_auc_score

from foretouch.types import Bool, Float64
from foretouch_lab.experiments.framework.experiment import Row, Table
from foretouch_lab.experiments.shared.tables import grouped
from foretouch_lab.learning.evaluation.metrics import BootstrapConfig, drawn_weights

BINS: Final = 15
_COLUMNS: Final = (
    *("left_out", "method", "grasps", "objects", "score", "score_low", "score_high", "slip_first", "slip_first_low"),
    *("slip_first_high", "slip_first_pairs", "calibration_error"),
)
_NOTE: Final = "[95 % interval by bootstrap over objects]"


def slip_first(chance: Float64, held: Bool, sessions: Any) -> tuple[Float64, Float64]:
    """Return (N,) won and all comparisons of each session of a grasp that held with one that did not and came before it, in the order of the rows."""
    won, pairs = [], []
    for name in np.unique(sessions):
        own, yes = chance[sessions == name], held[sessions == name]
        later = np.tri(len(own), k=-1, dtype=bool) & yes[:, None] & ~yes
        won.append(((own[:, None] > own) + 0.5 * (own[:, None] == own))[later].sum())
        pairs.append(later.sum())
    return np.array(won, np.float64), np.array(pairs, np.float64)


def calibration_error(chance: Float64, held: Bool, bins: int = BINS) -> float:
    """Return the mean difference of predicted and observed share over bins of equal width, weighted by their grasps."""
    place = np.minimum((chance * bins).astype(int), bins - 1)
    parts = [(place == k) for k in range(bins)]
    return float(sum(abs(chance[part].sum() - held[part].sum()) for part in parts if part.any()) / len(chance))


def _interval(scores: Sequence[float] | Float64, name: str) -> dict[str, float]:
    low, high = np.nanpercentile(scores, [2.5, 97.5])
    return {f"{name}_low": float(low), f"{name}_high": float(high)}


def tabulate(rows: Sequence[Row], config: BootstrapConfig) -> list[Row]:
    """Return rows of `results.csv`, of the rows of all cells."""
    result: list[Row] = []
    for (left_out, method), parts in grouped(rows, "left_out", "method"):
        chance, held, objects, sessions = (
            np.concatenate([np.array(part[key]) for part in parts]) for key in ("chance", "held", "objects", "sessions")
        )
        names, numbers = np.unique(objects, return_inverse=True)
        drawn = drawn_weights(len(names), config)[:, numbers]  # how often each grasp is in a resample
        facts: Row = {"grasps": len(held), "objects": len(names), "score": roc_auc_score(held, chance)}
        facts |= _interval([roc_auc_score(held, chance, sample_weight=weights) for weights in drawn], "score")
        facts["calibration_error"] = calibration_error(chance, held)
        won, against = slip_first(chance, held, sessions)
        if against.any():
            drawn = drawn_weights(len(won), config)
            facts |= {"slip_first": won.sum() / against.sum(), "slip_first_pairs": int(against.sum())}
            facts |= _interval(drawn @ won / (drawn @ against), "slip_first")
        result.append({"left_out": left_out, "method": method, **facts})
    return [{name: row.get(name) for name in _COLUMNS} for row in result]


def summarise(rows: Sequence[Row]) -> list[Table]:
    """Return a table for each way of leaving out."""
    tables, columns = [], ("method", "AUC", "AUC, slip before stable", f"calibration error, {BINS} bins")
    for left_out, parts in grouped(rows, "left_out"):
        lines = [
            [
                row["method"],
                _between(row, "score"),
                _between(row, "slip_first"),
                f"{float(row['calibration_error']):.3f}",
            ]
            for row in parts
        ]
        head = f"will it hold, {left_out} left out: {parts[0]['grasps']} grasps, {parts[0]['objects']} objects"
        pairs = f"; of {parts[0]['slip_first_pairs']} pairs of a session with the slip before the stable grasp, over sessions"
        tables.append(Table(head, columns, lines, [_NOTE + pairs * bool(parts[0]["slip_first_pairs"])]))
    return tables


def _between(row: Row, name: str) -> str:
    if row[name] in (None, ""):
        return ""
    return f"{float(row[name]):.3f} [{float(row[f'{name}_low']):.3f}, {float(row[f'{name}_high']):.3f}]"
