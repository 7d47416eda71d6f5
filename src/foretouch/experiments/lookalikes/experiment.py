# SPDX-License-Identifier: Apache-2.0
"""Objects that look alike and differ in stiffness: what sight can tell of them, and what touches add.

All grasps come in encounters: some grasps of one object, under a name of its own, since nobody who only looks can tell which
object it is. Half of each object's encounters are trained on; in the others it is touched as an unseen object is. The skill
compares with the mean over the look-alikes throughout. A predictor that was trained on the one object alone, as if it
were told which it is, shows how much there is to be gained ("told which").
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

from foretouch.config import setting
from foretouch.errors import DatasetError
from foretouch.experiments.framework.experiment import Cell, Experiment, Row, Table
from foretouch.experiments.framework.tables import skill_tables
from foretouch.experiments.shared.predictors import find_predictor
from foretouch.experiments.shared.real_grasps import EVERYTHING, FREE, labelled, score_table, seeded_predictors
from foretouch.experiments.shared.simulated_data import (
    SimulatedGrasps,
    SimulatedSettings,
    load_simulated,
    prepare_simulated,
)
from foretouch.experiments.unseen_object.experiment import UnseenObjectSettings, touch_rows
from foretouch.learning.data.training_set import labels_of
from foretouch.types import GraspSample

__all__ = ["EXPERIMENT", "TOLD", "LookalikesSettings"]

TOLD: Final = "told which"
_SIGHT: Final = "alike"  # trained on all of them


@dataclass(frozen=True, kw_only=True)
class LookalikesSettings(UnseenObjectSettings, SimulatedSettings):
    """Of `lookalikes`."""

    samples: int = setting(1200, "Grasps to simulate where --data is a scene", minimum=10, maximum=1_000_000)
    predictors: tuple[str, ...] = setting(("training_mean", "geometry_trees", "contact"), "Who is compared")
    touches: tuple[int, ...] = setting((0, 1, 3, 5), "Touches of the object at hand", minimum=0, maximum=1000)
    encounter: int = setting(25, "Grasps of one object in an encounter, the touched ones included", minimum=2)


def _sides(settings: LookalikesSettings, data: SimulatedGrasps) -> tuple[list[GraspSample], list[list[GraspSample]]]:
    """The grasps to train on and the encounters that are tested; each encounter is an object of its own name."""
    train: list[GraspSample] = []
    encounters: list[list[GraspSample]] = []
    samples = labelled(data.collection)
    for name in sorted({sample.object for sample in samples}):
        mine = [sample for sample in samples if sample.object == name]
        half = len(mine) // 2
        size = settings.encounter
        train += [replace(one, object=f"{name}/train{k // size:03d}") for k, one in enumerate(mine[:half])]
        for number, start in enumerate(range(half, len(mine) - size + 1, size)):
            met = mine[start : start + size]
            encounters.append([replace(sample, object=f"{name}/{number:03d}") for sample in met])
    if not encounters:
        raise DatasetError(f"{data.collection.name}: too few grasps for an encounter of {settings.encounter}")
    return train, encounters


def _cells(settings: LookalikesSettings, data: SimulatedGrasps) -> list[Cell]:
    kinds = sorted({sample.object for sample in data.collection.samples})
    return [
        Cell(f"{name}+{part}+seed{seed}", {"part": part, "predictor": name, "seed": seed})
        for seed, name in seeded_predictors(settings)
        for part in (_SIGHT, *kinds)
    ]


def _run(cell: Cell, settings: LookalikesSettings, data: SimulatedGrasps) -> list[Row]:
    train, encounters = _sides(settings, data)
    part, mean = cell.values["part"], labels_of(train).mean(axis=0)
    if part != _SIGHT:
        settings = settings.replace(touches=(0,))
        encounters = [one for one in encounters if _kind(one[0].object) == part]
        train = [sample for sample in train if _kind(sample.object) == part]
    fitted = find_predictor(cell.values["predictor"], settings.effort)(train, labels_of(train), cell.values["seed"])
    rows = [row for held in encounters for row in touch_rows(fitted, held, mean, settings)]
    return rows if part == _SIGHT else [{**row, "table": TOLD, "touches": None} for row in rows]


def _kind(encounter: str) -> str:
    return encounter.rpartition("/")[0]


def _tabulate(settings: LookalikesSettings, rows: Sequence[Row]) -> list[Row]:
    """Scores of all look-alikes together and of each, in the column `kind`; encounters are no rows of their own."""
    touches = {row["table"]: row["touches"] for row in rows}
    kinds = sorted({_kind(row["object"]) for row in rows})
    result: list[Row] = []
    for kind in (EVERYTHING, *kinds):
        mine = [row for row in rows if kind in (EVERYTHING, _kind(row["object"]))]
        scored = [row for row in score_table(settings, mine) if row["object"] == EVERYTHING]
        result += [{"kind": kind, "touches": touches[row["table"]], **row} for row in scored]
    return result


def _summarise(rows: Sequence[Row]) -> list[Table]:
    return skill_tables([row for row in rows if row["kind"] == EVERYTHING])


_SMOKE: Final[dict[str, Any]] = {"samples": 80, "encounter": 10, "effort": 0.1, "draws": 3, "bootstrap.draws": 200}

EXPERIMENT = Experiment(
    name="lookalikes",
    question="What can sight tell of objects that differ in stiffness only, and what do touches add?",
    module=__name__,
    settings=LookalikesSettings,
    presets={"full": {}, "smoke": _SMOKE},
    load=load_simulated,
    cells=_cells,
    run=_run,
    tabulate=_tabulate,
    summarise=_summarise,
    prepare=prepare_simulated,
    free=FREE,
)
