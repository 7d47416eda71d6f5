# SPDX-License-Identifier: Apache-2.0
"""Objects of one shape that differ in stiffness: what can be predicted from the cloud, and what touches add.

Grasps come in encounters: some grasps of one object under an object name of its own, since the cloud does not show
which object it is. Half of each object's encounters are for training; in the others it is touched as an unseen object
is. The reference of the skill is always the mean over all look-alikes. A predictor that is trained on the tested object
alone shows how much there is to gain.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

from foretouch.config import setting
from foretouch.errors import DatasetError
from foretouch.experiments.framework.experiment import Cell, Experiment, Row, Table
from foretouch.experiments.shared.predictors import find_predictor
from foretouch.experiments.shared.real_grasps import ALL_OBJECTS, RESUMABLE, labelled, score_table, seeded_predictors
from foretouch.experiments.shared.simulated_data import (
    SimulatedGrasps,
    SimulatedSettings,
    load_simulated,
    prepare_simulated,
)
from foretouch.experiments.shared.skill import skill_tables
from foretouch.experiments.unseen_object import UnseenObjectSettings, draw_over_touches, touch_rows
from foretouch.learning.data import labels_of
from foretouch.report.panels import Rows, new_figure, save
from foretouch.tactile import MODALITIES
from foretouch.types import GraspSample

__all__ = ["EXPERIMENT", "OBJECT_KNOWN", "LookalikesSettings"]

OBJECT_KNOWN: Final = "told which"
"""Value of the column `table` for predictors that were trained on the tested object alone."""

_ALL_TOGETHER: Final = "alike"  # part that is trained on all objects
_LOWEST_SKILL: Final = -0.2


@dataclass(frozen=True, kw_only=True)
class LookalikesSettings(UnseenObjectSettings, SimulatedSettings):
    """Settings of `lookalikes`."""

    samples: int = setting(1200, "Number of grasps to simulate if --data is a scene", minimum=10, maximum=1_000_000)
    predictors: tuple[str, ...] = setting(("training_mean", "geometry_trees", "contact"), "Predictors to compare")
    touches: tuple[int, ...] = setting((0, 1, 3, 5), "Numbers of touches of the object", minimum=0, maximum=1000)
    encounter: int = setting(25, "Grasps of one object in an encounter, including the touched ones", minimum=2)


def _sides(settings: LookalikesSettings, data: SimulatedGrasps) -> tuple[list[GraspSample], list[list[GraspSample]]]:
    """The training grasps and the tested encounters; each encounter is given an object name of its own."""
    train: list[GraspSample] = []
    encounters: list[list[GraspSample]] = []
    samples = labelled(data.collection)
    for name in sorted({sample.object for sample in samples}):
        subset = [sample for sample in samples if sample.object == name]
        half = len(subset) // 2
        size = settings.encounter
        train += [replace(one, object=f"{name}/train{k // size:03d}") for k, one in enumerate(subset[:half])]
        for number, start in enumerate(range(half, len(subset) - size + 1, size)):
            chosen = subset[start : start + size]
            encounters.append([replace(sample, object=f"{name}/{number:03d}") for sample in chosen])
    if not encounters:
        raise DatasetError(f"{data.collection.name}: too few grasps for an encounter of {settings.encounter}")
    return train, encounters


def _cells(settings: LookalikesSettings, data: SimulatedGrasps) -> list[Cell]:
    kinds = sorted({sample.object for sample in data.collection.samples})
    return [
        Cell(f"{name}+{part}+seed{seed}", {"part": part, "predictor": name, "seed": seed})
        for seed, name in seeded_predictors(settings)
        for part in (_ALL_TOGETHER, *kinds)
    ]


def _run(cell: Cell, settings: LookalikesSettings, data: SimulatedGrasps) -> list[Row]:
    train, encounters = _sides(settings, data)
    part, mean = cell.values["part"], labels_of(train).mean(axis=0)
    if part != _ALL_TOGETHER:
        settings = settings.replace(touches=(0,))
        encounters = [one for one in encounters if _kind(one[0].object) == part]
        train = [sample for sample in train if _kind(sample.object) == part]
    fitted = find_predictor(cell.values["predictor"], settings.effort)(train, labels_of(train), cell.values["seed"])
    rows = [row for one in encounters for row in touch_rows(fitted, one, mean, settings)]
    return rows if part == _ALL_TOGETHER else [{**row, "table": OBJECT_KNOWN, "touches": None} for row in rows]


def _kind(encounter: str) -> str:
    return encounter.rpartition("/")[0]


def _tabulate(settings: LookalikesSettings, rows: Sequence[Row]) -> list[Row]:
    """Scores of all look-alikes together and of each, by the column `kind`; encounters have no rows of their own."""
    touches = {row["table"]: row["touches"] for row in rows}
    kinds = sorted({_kind(row["object"]) for row in rows})
    result: list[Row] = []
    for kind in (ALL_OBJECTS, *kinds):
        subset = [row for row in rows if kind in (ALL_OBJECTS, _kind(row["object"]))]
        scored = [row for row in score_table(settings, subset) if row["object"] == ALL_OBJECTS]
        result += [{"kind": kind, "touches": touches[row["table"]], **row} for row in scored]
    return result


def _summarise(rows: Sequence[Row]) -> list[Table]:
    names = {OBJECT_KNOWN: "trained on the tested object alone"}
    together = [row for row in rows if row["kind"] == ALL_OBJECTS]
    return skill_tables([{**row, "table": names.get(row["table"], row["table"])} for row in together])


def _draw(rows: Rows, folder: Path) -> list[Path]:
    """Draw `lookalikes.png`: modalities side by side, all encounters together.

    Dashed if trained on the object alone.
    """
    together = [row for row in rows if row["kind"] == ALL_OBJECTS]
    predictors = list(dict.fromkeys(row["predictor"] for row in together))
    figure = new_figure(13.0, 3.8)
    panels = figure.subplots(1, len(MODALITIES), sharey=True, sharex=True)
    for axes, modality in zip(panels, MODALITIES, strict=True):
        subset = [row for row in together if row["modality"] == modality]
        draw_over_touches(
            axes, [row for row in subset if row["touches"] is not None], "predictor", predictors, _LOWEST_SKILL
        )
        for row in subset:
            if row["touches"] is None:
                axes.axhline(
                    row["skill"], color=f"C{predictors.index(row['predictor'])}", linestyle="--", linewidth=0.8
                )
        axes.set_title(modality)
        axes.set_xlabel("touches of the object")
    panels[0].set_ylabel("skill, 95 % interval\n(dashed: trained on that object alone)")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside right center", fontsize=8)
    return [save(figure, folder / "lookalikes.png")]


_SMOKE: Final[dict[str, Any]] = {"samples": 80, "encounter": 10, "effort": 0.1, "draws": 3, "bootstrap.draws": 200}

EXPERIMENT = Experiment(
    name="lookalikes",
    question="What can be predicted of objects that differ only in stiffness, and how much do touches add?",
    module=__name__,
    order=60,
    settings=LookalikesSettings,
    presets={"full": {}, "smoke": _SMOKE},
    load=load_simulated,
    cells=_cells,
    run=_run,
    tabulate=_tabulate,
    summarise=_summarise,
    figure=_draw,
    prepare=prepare_simulated,
    resumable_settings=RESUMABLE,
)
