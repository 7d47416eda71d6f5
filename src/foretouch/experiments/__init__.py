# SPDX-License-Identifier: Apache-2.0
"""Experiments: each one command that rebuilds its table and figures (`foretouch experiment NAME`).

`experiment` says what one is, `registry` lists them, `sweep` runs their cells so that a killed sweep goes on where it was.
"""

from foretouch.experiments.framework.experiment import EXPERIMENTS, Cell, Experiment, Row, Table, find_experiment
from foretouch.experiments.framework.sweep import SweepResult, run_sweep

__all__ = ["EXPERIMENTS", "Cell", "Experiment", "Row", "SweepResult", "Table", "find_experiment", "run_sweep"]
