# SPDX-License-Identifier: Apache-2.0
"""Experiments: each folder is one, and one command rebuilds its table and figures (`foretouch experiment NAME`).

`framework` runs any experiment, also a user's own; `shared` holds what several of the experiments here have in common.
A killed sweep is resumed where it was.
"""

from foretouch_lab.experiments.framework.experiment import (
    Cell,
    Experiment,
    Row,
    Table,
    find_experiment,
    list_experiments,
)
from foretouch_lab.experiments.framework.sweep import Sweep

__all__ = ["Cell", "Experiment", "Row", "Sweep", "Table", "find_experiment", "list_experiments"]
