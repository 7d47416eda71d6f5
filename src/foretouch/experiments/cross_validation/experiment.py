# SPDX-License-Identifier: Apache-2.0
"""How well is another grasp of the same sessions predicted? P1's five random folds, over all objects.

The easiest question: neighbours in time land on both sides, so object, session and drift are known.
"""

from __future__ import annotations

from foretouch.experiments.framework.experiment import Experiment
from foretouch.experiments.framework.tables import skill_tables
from foretouch.experiments.shared.folds import FoldRunner, split_parts
from foretouch.experiments.shared.real_grasps import FREE, PRESETS, RealGraspSettings, load, score_table

__all__ = ["EXPERIMENT"]

_RUNNER = FoldRunner(split_parts("random"))

EXPERIMENT = Experiment(
    name="cross_validation",
    question="How well is another grasp of the same sessions predicted?",
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
