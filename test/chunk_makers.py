# SPDX-License-Identifier: Apache-2.0
"""Makes the samples of a chunk on any node, and leaves a trace of each chunk that was begun."""

import os
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from recording_builders import record

from foretouch.dataset.samples import only_finite
from foretouch.errors import SimulationError
from foretouch.types import GraspSample


def make(
    trace: Path, pause_s: float, broken: int, slots: range, write: Callable[[GraspSample], None]
) -> dict[str, Any]:
    (trace / f"{slots.start}.{os.getpid()}.{time.monotonic_ns()}").touch()
    time.sleep(pause_s)
    for slot in slots:
        if slot == broken:
            raise SimulationError(f"slot {slot}: is broken", "broken")
        write(replace(only_finite(record(slot).sample), id=f"ball/{slot:06d}"))
    return {"first": slots.start, "mean": float(np.mean(slots))}
