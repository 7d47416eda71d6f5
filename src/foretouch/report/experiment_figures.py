# SPDX-License-Identifier: Apache-2.0
"""The figures of each experiment, drawn from the rows of its `results.csv` alone."""

from __future__ import annotations

import importlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

__all__ = ["FIGURES", "draw_figures"]

FIGURES: Final = {
    "cross_validation": "experiment_skills",
    "time_blocked": "experiment_skills",
    "cross_type": "experiment_types",
    "unseen_object": "experiment_touches",
    "sim_to_real": "experiment_touches",
    "noise_ceiling": "experiment_ceiling",
    "lookalikes": "experiment_lookalikes",
    "coverage": "experiment_coverage",
    "ablation": "experiment_ablation",
    "learning_curve": "experiment_learning_curve",
    "label_ratio": "label_ratio_figure",
}
"""By experiment, the module beside this one whose `draw(rows, folder)` returns the paths that it wrote."""


def draw_figures(experiment: str, rows: Sequence[Mapping[str, Any]], folder: Path) -> list[Path]:
    """Draw an experiment's figures into a folder; none for an experiment of someone's own.

    Args:
        experiment: Its name.
        rows: Of `results.csv`, at least one.
        folder: Where to.
    """
    if experiment not in FIGURES:
        return []
    module = importlib.import_module(f"foretouch.report.{FIGURES[experiment]}")
    return list(module.draw(rows, folder))
