# SPDX-License-Identifier: Apache-2.0
"""How well is a later or earlier grasp of the same objects predicted? Five blocks of time within each object.

The folds do not depend on the seed, which here only moves the predictors.
"""

from __future__ import annotations

from foretouch.experiments.framework.experiment import Experiment
from foretouch.experiments.framework.tables import skill_tables
from foretouch.experiments.shared.folds import FoldRunner, split_parts
from foretouch.experiments.shared.real_grasps import FREE, PRESETS, RealGraspSettings, load, score_table

__all__ = ["EXPERIMENT"]

_RUNNER = FoldRunner(split_parts("time"))

EXPERIMENT = Experiment(
    name="time_blocked",
    question="How well is a later or earlier grasp of the same objects predicted?",
    module=__name__,
    settings=RealGraspSettings,
    presets=PRESETS,
    load=load,
    cells=_RUNNER.cells,
    run=_RUNNER.run,
    tabulate=score_table,
    summarise=skill_tables,
    free=FREE,
    data_folder="vision2tactile",
)
