# SPDX-License-Identifier: Apache-2.0
"""Is what was learned in simulation of use on real grasps of objects that were never felt?

Asked as in `unseen_object`: each real object is left out once, and met without a touch and after some. Beside those who
learn from the other real objects alone stand those who lean on trees that were taught by simulated grasps
(`simulated_teacher`). Nothing of the real object left out takes part before it is touched.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

from foretouch.config import setting
from foretouch.experiments.framework.experiment import Cell, Experiment, Row
from foretouch.experiments.shared.predictors import PREDICTORS, Fit, find_predictor, shrunk_residuals
from foretouch.experiments.shared.real_grasps import FREE, labelled, seeded_predictors
from foretouch.experiments.shared.simulated_data import BothSettings, RealAndSimulated, load_both, prepare_both
from foretouch.experiments.sim_to_real.teacher import LEANINGS, simulated_changes
from foretouch.experiments.unseen_object.experiment import (
    UnseenObjectSettings,
    summarise_touches,
    tabulate_touches,
    touch_rows,
)
from foretouch.learning.data.folds import make_folds
from foretouch.learning.data.training_set import labels_of
from foretouch.learning.evaluation.baselines import TREES
from foretouch.types import Float64, GraspSample

__all__ = ["EXPERIMENT", "SimToRealSettings"]


@dataclass(frozen=True, kw_only=True)
class SimToRealSettings(UnseenObjectSettings, BothSettings):
    """Of `sim_to_real`."""

    scene: str = setting("config/scenes/rigid.yaml", "Scene that the teacher learns from")
    samples: int = setting(2000, "Grasps of it", minimum=10, maximum=1_000_000)
    predictors: tuple[str, ...] = setting(
        ("training_mean", "geometry_trees", *LEANINGS, "contact"), "Who is compared", choices=(*PREDICTORS, *LEANINGS)
    )
    touches: tuple[int, ...] = setting((0, 1, 3, 5), "Touches of the new object", minimum=0, maximum=1000)


def _cells(settings: SimToRealSettings, data: RealAndSimulated) -> list[Cell]:
    return [
        Cell(f"{name}+{fold.name}+seed{seed}", {"part": fold.name, "predictor": name, "seed": seed})
        for seed, name in seeded_predictors(settings)
        for fold in make_folds(labelled(data.real), "object", 0)
    ]


def _run(cell: Cell, settings: SimToRealSettings, data: RealAndSimulated) -> list[Row]:
    samples = labelled(data.real)
    held = [sample for sample in samples if sample.object == cell.values["part"]]
    train = [sample for sample in samples if sample.object != cell.values["part"]]
    labels, seed = labels_of(train), cell.values["seed"]
    fitted = _predictor(cell.values["predictor"], settings, data, seed)(train, labels, seed)
    return touch_rows(fitted, held, labels.mean(axis=0), settings)


def _predictor(name: str, settings: SimToRealSettings, data: RealAndSimulated, seed: int) -> Fit:
    if name not in LEANINGS:
        return find_predictor(name, settings.effort)
    trees = max(1, round(settings.effort * TREES))
    return shrunk_residuals(LEANINGS[name](_said(data, seed, trees), trees))


@lru_cache(maxsize=1)
def _said(data: RealAndSimulated, seed: int, trees: int) -> dict[str, Float64]:
    simulated: Sequence[GraspSample] = labelled(data.simulated)
    return simulated_changes(simulated, labelled(data.real), seed, trees)


EXPERIMENT = Experiment(
    name="sim_to_real",
    question="Is what was learned in simulation of use on real grasps of objects that were never felt?",
    module=__name__,
    settings=SimToRealSettings,
    presets={"full": {}, "smoke": {"samples": 100, "effort": 0.1, "draws": 3, "bootstrap.draws": 200}},
    load=load_both,
    cells=_cells,
    run=_run,
    tabulate=tabulate_touches,
    summarise=summarise_touches,
    prepare=prepare_both,
    free=FREE,
    data_folder="vision2tactile",
)
