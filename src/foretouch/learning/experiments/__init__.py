# SPDX-License-Identifier: Apache-2.0
"""Experiments: each one command that rebuilds its table and figures (`foretouch experiment NAME`).

`experiment` says what one is, `registry` lists them, `sweep` runs their cells so that a killed sweep goes on where it was.
"""

from foretouch.learning.experiments.experiment import Cell, Experiment, Row, Table
from foretouch.learning.experiments.registry import EXPERIMENTS, find_experiment
from foretouch.learning.experiments.sweep import SweepResult, run_sweep

__all__ = ["EXPERIMENTS", "Cell", "Experiment", "Row", "SweepResult", "Table", "find_experiment", "run_sweep"]
