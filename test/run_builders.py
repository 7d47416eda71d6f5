# SPDX-License-Identifier: Apache-2.0
"""A configuration that trains within a second, and what to say, or not, of a run."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from foretouch.learning.training.run_config import IDLE, RunConfig

MODEL = {"n_points": 32, "tnet": False, "trunk_widths": [8, 16], "head_widths": [16], "outputs": ["PDC_TH"]}
BASE: dict[str, Any] = {
    "name": "tiny",
    "model": MODEL,
    "train": {"epochs": 4, "batch_size": 8, "target_scaling": "standardised"},
    "srgan": {
        "epochs": 4,
        "batch_size": 5,
        "learning_rate": 0.001,
        "generator": {"widths": [6], "stride": 2, "channels": 3},
    },
}


def run_config(**changes: Any) -> RunConfig:
    """`BASE` with some groups replaced, without those that the method does not look at."""
    given = {**BASE, **changes}
    idle = IDLE[given.get("method", "supervised")]
    return RunConfig.from_mapping({key: value for key, value in given.items() if key not in idle})


def quiet(_record: Mapping[str, Any]) -> None:
    """Says nothing."""


def stop_after(epoch: int) -> Callable[[Mapping[str, Any]], None]:
    """Interrupts the run once an epoch is on the disk."""

    def say(record: Mapping[str, Any]) -> None:
        if record.get("epoch") == epoch:
            raise KeyboardInterrupt

    return say
