# SPDX-License-Identifier: Apache-2.0
"""Time variants, and measure their memory and how their answers differ."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from foretouch.experiments.framework.experiment import Row
from foretouch.timing import time_calls
from foretouch.tradeoff.area import Answer, Timed
from foretouch.types import Float64


def time_variants(
    timed: Mapping[str, Timed],
    requests: Sequence[int],
    seconds: float,
    seed: int,
    progress: Callable[[int, int], None] = lambda *_: None,
) -> list[Row]:
    """Time every variant with every size of request, all calls in one random order: see `time_calls`.

    Returns:
        For each variant and size: `variant`, `request`, `calls`, wall times `ms_p50`, `ms_p95`, `ms_p99` and the median
        processor time `cpu_ms` [ms].
    """
    found = time_calls({name: one.answer for name, one in timed.items()}, requests, seconds, progress, seed=seed)
    return [
        {"variant": name, "request": request, "calls": len(times), **_quantiles(times, timed[name].whole)}
        for (name, request), times in found.items()
    ]


def _quantiles(times: Float64, whole: float) -> Row:
    values = [*np.percentile(times[:, 0], (50, 95, 99)), np.median(times[:, 1])]
    names = ("ms_p50", "ms_p95", "ms_p99", "cpu_ms")
    return {name: float(f"{1e3 * whole * value:.4g}") for name, value in zip(names, values, strict=True)}


def peak_memory_mb(call: Callable[[], Any]) -> float | None:
    """Memory that a call needs beyond what the process had, at its peak [MB]; None if it is unknown."""
    try:
        ctypes.CDLL(None).malloc_trim(0)  # else the call could use what earlier calls have freed
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")
        before = _status_mb("VmRSS")
    except (OSError, AttributeError):
        return None
    call()
    return max(0.0, _status_mb("VmHWM") - before)


def _status_mb(name: str) -> float:
    for line in Path("/proc/self/status").read_text(encoding="ascii").splitlines():
        if line.startswith(f"{name}:"):
            return int(line.split()[1]) / 1024.0
    raise OSError(f"/proc/self/status: holds no {name}")


def largest_difference(answer: Answer, other: Answer) -> float | None:
    """Largest difference of two answers; None if they cannot be compared."""
    if answer.shape != other.shape:
        return None
    return float(np.abs(answer.astype(np.float64) - other.astype(np.float64)).max(initial=0.0))
