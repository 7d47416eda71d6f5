# SPDX-License-Identifier: Apache-2.0
"""The figures of each experiment, drawn from the rows of its `results.csv` alone."""

from __future__ import annotations

import importlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

__all__ = ["FIGURES", "draw_figures"]

FIGURES: Final = {
    "cross_validation": "shared.skill_figure",
    "time_blocked": "shared.skill_figure",
    "cross_type": "cross_type.figure",
    "unseen_object": "unseen_object.figure",
    "sim_to_real": "unseen_object.figure",
    "noise_ceiling": "noise_ceiling.figure",
    "lookalikes": "lookalikes.figure",
    "coverage": "coverage.figure",
    "ablation": "ablation.figure",
    "learning_curve": "learning_curve.figure",
    "label_ratio": "label_ratio.figure",
}
"""By experiment, the module below `foretouch.experiments` whose `draw(rows, folder)` returns the paths that it wrote."""


def draw_figures(experiment: str, rows: Sequence[Mapping[str, Any]], folder: Path) -> list[Path]:
    """Draw an experiment's figures into a folder; none for an experiment of someone's own.

    Args:
        experiment: Its name.
        rows: Of `results.csv`, at least one.
        folder: Where to.
    """
    if experiment not in FIGURES:
        return []
    module = importlib.import_module(f"foretouch.experiments.{FIGURES[experiment]}")
    return list(module.draw(rows, folder))
