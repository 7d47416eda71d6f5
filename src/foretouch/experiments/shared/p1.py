# SPDX-License-Identifier: Apache-2.0
"""The types of objects of P1, and its published errors.

P1 recorded a crisps can and a coffee can, a snacks box (cheezit) and a sugar box. The sugar box is not in the public
data: `boxes` are all boxes of the data.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from foretouch.config import Settings, setting
from foretouch.errors import ConfigError
from foretouch.experiments.shared.figures import draw_series
from foretouch.learning.data import Indices
from foretouch.report.panels import Rows
from foretouch.types import GraspSample

if TYPE_CHECKING:
    from matplotlib.axes import Axes

ACROSS: Final = "across types"
PUBLISHED: Final[dict[str, dict[str, tuple[float, float | None]]]] = {
    "within p1_cylinders": {
        "PDC_TH": (208.0, 0.067),
        "PDC_MF": (153.0, 0.076),
        "E_TH": (216.0, 0.061),
        "E_MF": (231.0, 0.060),
    },
    "within boxes": {
        "PDC_TH": (278.0, 0.089),
        "PDC_MF": (164.0, 0.081),
        "E_TH": (232.0, 0.066),
        "E_MF": (212.0, 0.055),
    },
    ACROSS: {"PDC_TH": (236.0, None), "PDC_MF": (165.0, None), "E_TH": (317.0, None), "E_MF": (310.0, None)},
}
"""P1, sections III and IV: RMSE [counts] and over its divisors, by the closest of our tables."""

P1: Final = "P1 (published)"
"""Its name among the predictors."""


@dataclass(frozen=True, kw_only=True)
class ObjectTypes(Settings):
    """Types of the objects, by their names in the dataset."""

    cylinders: tuple[str, ...] = setting(("campbells", "coffee", "pringles"), "Cans")
    boxes: tuple[str, ...] = setting(("cheezit", "spam", "wood"), "Boxes and blocks")
    p1_cylinders: tuple[str, ...] = setting(("coffee", "pringles"), "Cans that P1 was trained on")

    def __post_init__(self) -> None:
        super().__post_init__()
        if both := sorted(set(self.cylinders) & set(self.boxes)):
            raise ConfigError(f"ObjectTypes.boxes: {both[0]!r} is a cylinder as well")

    def indices(self, samples: Sequence[GraspSample]) -> dict[str, Indices]:
        """Samples of each type."""
        types = self.to_mapping().items()
        return {name: np.array([k for k, s in enumerate(samples) if s.object in own], np.intp) for name, own in types}


def draw_errors(axes: Axes, rows: Rows, *, tables: Sequence[str], predictors: Sequence[str], values: str) -> None:
    """Draw the error of each predictor over the tables; published errors are black stars."""
    styles: dict[str, dict[str, Any]] = {
        "every": {"linestyle": ""},
        P1: {"color": "black", "marker": "*", "markersize": 9},
    }
    draw_series(axes, rows, "table", "predictor", predictors, values=values, places=tables, spread=0.1, styles=styles)
    axes.set_xticks(range(len(tables)), [name.replace(" ", "\n", 1) for name in tables], fontsize=8)
    axes.set_ylim(bottom=0.0)
    axes.margins(x=0.15)
