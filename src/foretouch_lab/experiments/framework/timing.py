# SPDX-License-Identifier: Apache-2.0
"""Time calls in random order, and distinguish a loaded machine from an idle one."""

import os
import platform
import re
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from foretouch.base.files import read_bytes


class MachineLoad:
    """What other processes use of this machine from its construction on."""

    def __init__(self) -> None:
        self._start = self._now()

    def row(self) -> dict[str, Any]:
        """Return columns `state` (idle or loaded) and `other_cores`."""
        busy, own, wall = (now - before for now, before in zip(self._now(), self._start, strict=True))
        others = max(0.0, busy - own) / max(wall, 1e-9)
        return {"state": "idle" if others < 0.15 else "loaded", "other_cores": round(others, 2)}

    @staticmethod
    def _now() -> tuple[float, float, float]:
        """Return busy time of all cores, processor time of this process and of its children that ended, and wall time [s]."""
        fields = read_bytes("/proc/stat").decode("ascii").split("\n", 1)[0].split()[1:]
        user, nice, system, _idle, _wait, irq, softirq, steal = map(int, fields[:8])
        busy_s = (user + nice + system + irq + softirq + steal) / os.sysconf("SC_CLK_TCK")
        return busy_s, sum(os.times()[:4]), time.monotonic()


def cpu_name() -> str:
    """Return the model of the processor."""
    info = Path("/proc/cpuinfo")
    names = re.findall(r"model name\s*:\s*(.+)", read_bytes(info).decode("utf-8")) if info.exists() else []
    return names[0] if names else platform.processor()


def time_calls(
    functions: Mapping[str, Callable[[int], object]],
    sizes: Sequence[int],
    seconds: float,
    progress: Callable[[int, int], None] = lambda *_: None,
    pause_s: float = 0.0,
) -> dict[tuple[str, int], npt.NDArray[np.float64]]:
    """Time every function with every size of request, all calls in one random order.

    Args:
        functions: By name.
        sizes: Ascending. One that would take a function longer than 3 s is left out.
        seconds: Time of all calls and pauses; each function and size gets the same share, and at least 5 calls [s].
        progress: Called with the number of calls done and of all.
        pause_s: Time asleep before each call: a process that waits for its input finds the processor's caches cold [s].

    Returns:
        For each function and size (calls, 2): wall time and processor time [s].
    """
    first = {(name, size): s for name, call in functions.items() for size, s in _first_calls(call, sizes).items()}
    share = seconds / max(len(first), 1)
    counts = [int(np.clip(share / (s + pause_s), 5, 400)) for s in first.values()]
    order = np.random.default_rng(0).permutation(np.repeat(np.arange(len(first)), counts))
    keys = list(first)
    times: dict[tuple[str, int], list[tuple[float, float]]] = {key: [] for key in first}
    for done, k in enumerate(order):
        name, size = keys[k]
        time.sleep(pause_s)
        start, start_cpu = time.perf_counter(), time.process_time()
        functions[name](size)
        times[keys[k]].append((time.perf_counter() - start, time.process_time() - start_cpu))
        progress(done + 1, len(order))
    return {key: np.array(measured) for key, measured in times.items()}


def _first_calls(call: Callable[[int], object], sizes: Sequence[int]) -> dict[int, float]:
    """Warm up, and estimate the time of one call by size [s]; sizes that would take too long are left out."""
    seconds_of: dict[int, float] = {}
    for size in sizes:
        if seconds_of and (last := max(seconds_of)) and seconds_of[last] * size / last > 3.0:
            break
        call(size)
        start = time.perf_counter()
        call(size)
        seconds_of[size] = max(time.perf_counter() - start, 1e-7)
    return seconds_of
