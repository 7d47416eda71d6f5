# SPDX-License-Identifier: Apache-2.0
"""Time callables in one process and in random order, and distinguish a loaded machine from an idle one."""

from __future__ import annotations

import ctypes
import os
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from foretouch.experiments.framework.experiment import Row
from foretouch.tradeoff.area import Answer, Timed

_FEWEST: Final = 5  # calls of each callable and request
_MOST: Final = 400
_SLOWEST_S: Final = 3.0  # a request that would take longer is not timed
_IDLE_CORES: Final = 0.15  # that other processes may use on an idle machine
_JIFFY_S: Final = 1.0 / os.sysconf("SC_CLK_TCK")


@dataclass(frozen=True)
class _Call:
    variant: str
    request: int
    seconds: float  # of one call, first estimate


class MachineLoad:
    """What other processes use of this machine from its construction on."""

    def __init__(self) -> None:
        self.load_before = os.getloadavg()[0]
        self._start = self._now()

    def row(self) -> Row:
        """Columns `state` (idle or loaded), `other_cores`, `load_before` and `load_after`."""
        busy, own, wall = (now - before for now, before in zip(self._now(), self._start, strict=True))
        others = max(0.0, busy - own) / max(wall, 1e-9)
        return {
            "state": "idle" if others < _IDLE_CORES else "loaded",
            "other_cores": round(others, 2),
            "load_before": round(self.load_before, 2),
            "load_after": round(os.getloadavg()[0], 2),
        }

    @staticmethod
    def _now() -> tuple[float, float, float]:
        """Busy time of all cores, processor time of this process, and wall time [s]."""
        fields = Path("/proc/stat").read_text(encoding="ascii").split("\n", 1)[0].split()[1:]
        user, nice, system, _idle, _wait, irq, softirq, steal = map(int, fields[:8])
        return (user + nice + system + irq + softirq + steal) * _JIFFY_S, time.process_time(), time.monotonic()


def time_variants(
    timed: Mapping[str, Timed],
    requests: Sequence[int],
    seconds: float,
    seed: int,
    progress: Callable[[int, int], None] = lambda *_: None,
    pause_s: float = 0.0,
) -> list[Row]:
    """Time every variant with every size of request, all calls in one random order.

    Args:
        timed: By name.
        requests: Sizes, ascending. One that would take a variant longer than 3 s is left out.
        seconds: Time of all calls and pauses; each variant and size gets the same share, and at least 5 calls [s].
        seed: Of the order.
        progress: Called with the number of calls done and of all.
        pause_s: Time asleep before each call: a process that waits for its input finds the processor's caches cold [s].

    Returns:
        For each variant and size: `variant`, `request`, `calls`, wall times `ms_p50`, `ms_p95`, `ms_p99` and the median
        processor time `cpu_ms` [ms].
    """
    calls = [call for name, one in timed.items() for call in _first_calls(name, one, requests)]
    share = seconds / max(len(calls), 1)
    counts = [int(np.clip(share / (call.seconds + pause_s), _FEWEST, _MOST)) for call in calls]
    order = np.random.default_rng(seed).permutation(np.repeat(np.arange(len(calls)), counts))
    wall: list[list[float]] = [[] for _ in calls]
    cpu: list[list[float]] = [[] for _ in calls]
    for done, k in enumerate(order):
        call = calls[k]
        answer = timed[call.variant].answer
        time.sleep(pause_s)
        start, start_cpu = time.perf_counter(), time.process_time()
        answer(call.request)
        wall[k].append(time.perf_counter() - start)
        cpu[k].append(time.process_time() - start_cpu)
        progress(done + 1, len(order))
    return [
        {"variant": call.variant, "request": call.request, "calls": counts[k]}
        | _quantiles(wall[k], cpu[k], timed[call.variant].whole)
        for k, call in enumerate(calls)
    ]


def _first_calls(name: str, one: Timed, requests: Sequence[int]) -> list[_Call]:
    """Warm up, and estimate the time of one call."""
    calls: list[_Call] = []
    for request in requests:
        if calls and calls[-1].seconds * request / calls[-1].request > _SLOWEST_S:
            break
        one.answer(request)
        start = time.perf_counter()
        one.answer(request)
        calls.append(_Call(name, request, max(time.perf_counter() - start, 1e-7)))
    return calls


def _quantiles(wall: Sequence[float], cpu: Sequence[float], whole: float) -> Row:
    middle, high, highest = np.percentile(wall, (50, 95, 99)) * 1e3
    values = {"ms_p50": middle, "ms_p95": high, "ms_p99": highest, "cpu_ms": float(np.median(cpu)) * 1e3}
    return {key: float(f"{whole * value:.4g}") for key, value in values.items()}


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
