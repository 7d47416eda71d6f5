# SPDX-License-Identifier: Apache-2.0
"""Rows of `ablation` as skills, each with its difference from the whole model, or from what there is to lean on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from foretouch.config import setting
from foretouch.experiments.ablation.parts import FULL
from foretouch.experiments.framework.experiment import Row, Table
from foretouch.experiments.shared.real_grasps import EVERYTHING, RealGraspSettings, score_table
from foretouch.learning.evaluation.comparison import MEAN, BootstrapConfig
from foretouch.tactile.modalities import MODALITIES

__all__ = ["NOTHING", "TARE", "ablation_rows", "ablation_tables"]

NOTHING: Final = "nothing"
TARE: Final = "tare"
_TOUCHES: Final = "3 touches"
_SIGNS: Final = {"better": " ▲", "worse": " ▼", "tie": " ="}


@dataclass(frozen=True, kw_only=True)
class _Scoring(RealGraspSettings):
    predictors: tuple[str, ...] = setting((), "Variants")
    references: tuple[str, ...] = setting((FULL, NOTHING, TARE, _TOUCHES), "Whom the others are compared with")


def ablation_rows(rows: Sequence[Row], config: BootstrapConfig) -> list[Row]:
    """The rows of `results.csv`, without those of single objects.

    Args:
        rows: Of `error_rows`, with `table`, `part`, `predictor` (the variant) and `seed`. Of divisions that met the same
            object, errors are added up.
        config: Of the bootstrap.
    """
    variants = tuple(dict.fromkeys(row["predictor"] for row in rows))
    scored = score_table(_Scoring(predictors=variants, bootstrap=config), rows)
    return [row for row in scored if row["object"] == EVERYTHING]


def ablation_tables(rows: Sequence[Row]) -> list[Table]:
    """A table for each ground: skill, and the difference from the whole model or from nothing to lean on."""
    tables = []
    for name in dict.fromkeys(row["table"] for row in rows):
        mine = [row for row in rows if row["table"] == name]
        who = list(dict.fromkeys(row["predictor"] for row in mine))
        reference = FULL if FULL in who else NOTHING
        body = [[one, *(_cell(row, reference) for row in mine if row["predictor"] == one)] for one in who]
        title = f"{name}: {mine[0]['objects']} objects, against `{reference}`"
        tables.append(Table(title, ["skill", *MODALITIES, MEAN], body))
    notes = [
        "skill: 0 is the mean of the training labels, 1 is perfect",
        "(difference from the reference [95 % interval by bootstrap over objects]): ▲ better, ▼ worse, = tie",
    ]
    last = tables[-1]
    return [*tables[:-1], Table(last.title, last.columns, last.rows, notes)]


def _cell(row: Row, reference: str) -> str:
    text = f"{row['skill']:.3f}"
    if row[f"vs_{reference}"] is None:
        return text
    difference = f"({row[f'vs_{reference}']:+.3f}{_SIGNS.get(row[f'vs_{reference}_verdict'], '')}"
    if row[f"vs_{reference}_low"] is not None:
        difference += f"\n[{row[f'vs_{reference}_low']:+.3f}, {row[f'vs_{reference}_high']:+.3f}]"
    return f"{text} {difference})"
