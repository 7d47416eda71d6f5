# SPDX-License-Identifier: Apache-2.0
"""The experiments by name."""

from __future__ import annotations

import importlib
from typing import Any, Final

from foretouch.errors import ConfigError
from foretouch.learning.experiments.experiment import Experiment

__all__ = ["EXPERIMENTS", "find_experiment"]

EXPERIMENTS: Final = {
    name: f"foretouch.learning.experiments.{name}"
    for name in (
        "cross_validation",
        "time_blocked",
        "cross_type",
        "unseen_object",
        "noise_ceiling",
        "lookalikes",
        "sim_to_real",
        "coverage",
        "ablation",
        "learning_curve",
        "label_ratio",
        "label_ratio_tuning",
    )
}


def find_experiment(name: str) -> Experiment[Any, Any]:
    """An experiment by name, or by the module of one's own that holds an `EXPERIMENT`, such as `my_lab.stiffness`.

    Raises:
        ConfigError: If there is none.
    """
    if name not in EXPERIMENTS and "." not in name:
        raise ConfigError(f"experiment: {name!r} is none of {', '.join(EXPERIMENTS)}")
    module = EXPERIMENTS.get(name, name)
    try:
        found = getattr(importlib.import_module(module), "EXPERIMENT", None)
    except ModuleNotFoundError as err:
        raise ConfigError(f"experiment: {name}: {err}") from err
    if not isinstance(found, Experiment):
        raise ConfigError(f"experiment: {name}: holds no EXPERIMENT")
    return found
