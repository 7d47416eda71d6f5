# SPDX-License-Identifier: Apache-2.0
"""What a node reports in /diagnostics: its state, rate, ages and latencies, and what became of every input."""

import os
import threading
import time
from collections import Counter, deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue

_WINDOW: Final = 300  # latest inputs for quantiles and rates: ten seconds at 30 Hz


@dataclass(frozen=True, kw_only=True)
class InputSummary:
    """Counts since the start, received = used + sum(dropped) + waiting, and quantiles over the latest inputs."""

    received: int  # inputs that arrived; messages of several topics that belong to one cloud are one input
    used: int  # inputs that were answered
    dropped: Mapping[str, int]  # inputs that will not be answered, by reason
    waiting: int  # inputs not yet answered
    lost: int  # messages that the middleware lost before they arrived; not part of `received`
    rate_hz: float  # answers per second over the latest inputs
    input_age_ms: tuple[float, float] | None  # p50 and p95 from the stamp of an input to the start of the work
    latency_ms: tuple[float, float] | None  # p50 and p95 from arrival to publication; None before the first
    idle_s: float | None  # time since the last arrival; None before the first


class InputStatistics:
    """Counts inputs and keeps the latest times. Thread-safe."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._received = self._used = self._lost = 0
        self._dropped: Counter[str] = Counter()
        self._ages: deque[float] = deque(maxlen=_WINDOW)
        self._latencies: deque[float] = deque(maxlen=_WINDOW)
        self._answers: deque[float] = deque(maxlen=_WINDOW)
        self._last_arrival: float | None = None

    def receive(self) -> float:
        """Count an input and return its time of arrival, `time.monotonic` [s]."""
        now = time.monotonic()
        with self._lock:
            self._received += 1
            self._last_arrival = now
        return now

    def use(self, arrived: float, input_age_s: float) -> None:
        """Count an answer to an input that arrived at a time [s], so long after its stamp [s]."""
        now = time.monotonic()
        with self._lock:
            self._used += 1
            self._ages.append(input_age_s * 1e3)
            self._latencies.append((now - arrived) * 1e3)
            self._answers.append(now)

    def drop(self, reason: str) -> None:
        """Count an input that is not answered."""
        with self._lock:
            self._dropped[reason] += 1

    def lose(self, count: int) -> None:
        """Count messages that the middleware lost."""
        with self._lock:
            self._lost += count

    def summary(self) -> InputSummary:
        """Summarise all inputs so far."""
        now = time.monotonic()
        with self._lock:
            dropped = dict(self._dropped)
            span = now - self._answers[0] if self._answers else 0.0
            return InputSummary(
                received=self._received,
                used=self._used,
                dropped=dropped,
                waiting=self._received - self._used - sum(dropped.values()),
                lost=self._lost,
                rate_hz=len(self._answers) / span if span > 0.0 else 0.0,
                input_age_ms=_quantiles(self._ages),
                latency_ms=_quantiles(self._latencies),
                idle_s=None if self._last_arrival is None else now - self._last_arrival,
            )


def _quantiles(values: deque[float]) -> tuple[float, float] | None:
    if not values:
        return None
    middle, high = np.percentile(np.asarray(values), (50, 95))
    return float(middle), float(high)


def diagnostic_status(
    name: str,
    state: str,
    now: InputSummary,
    before: InputSummary | None = None,
    *,
    errors: Sequence[str] = (),
    warnings: Sequence[str] = (),
    notes: Mapping[str, str] | None = None,
    silence_s: float | None = None,
) -> DiagnosticStatus:
    """Make the report of one node: a level, one line of text, and all numbers.

    `state` is that of its lifecycle, `now` and `before` are the counts of its inputs, now and at the last report: what
    was dropped since is a warning. `errors` keep it from working, `warnings` are problems around it, `notes` are
    further values by key. No input for longer than `silence_s` is a warning; None for a node without inputs.
    """
    warnings = [*warnings, *(_silence(now, silence_s) if state == "active" else []), *_drops(now, before)]
    if errors:
        level, message = DiagnosticStatus.ERROR, "; ".join(errors)
    elif warnings:
        level, message = DiagnosticStatus.WARN, "; ".join(warnings)
    else:
        level, message = DiagnosticStatus.OK, f"{state}, {now.rate_hz:.1f} Hz"
    values = {"state": state, "pid": str(os.getpid()), **_numbers(now), **(notes or {})}
    pairs = [KeyValue(key=key, value=value) for key, value in values.items()]
    return DiagnosticStatus(level=level, name=name, message=message, hardware_id="none", values=pairs)


def _silence(now: InputSummary, limit_s: float | None) -> list[str]:
    if limit_s is None:
        return []
    if now.idle_s is None:
        return ["no input yet"]
    return [f"no input for {now.idle_s:.1f} s"] if now.idle_s > limit_s else []


def _drops(now: InputSummary, before: InputSummary | None) -> list[str]:
    recent = Counter(now.dropped) - Counter(before.dropped if before else {})
    recent["lost in transport"] = now.lost - (before.lost if before else 0)
    texts = [f"{count} {reason}" for reason, count in recent.items() if count]
    return [f"dropped: {', '.join(texts)}"] if texts else []


def _numbers(now: InputSummary) -> dict[str, str]:
    numbers = {
        "rate_hz": f"{now.rate_hz:.2f}",
        "received": str(now.received),
        "used": str(now.used),
        "dropped": str(sum(now.dropped.values())),
        **{f"dropped.{reason}": str(count) for reason, count in sorted(now.dropped.items())},
        "waiting": str(now.waiting),
        "lost_on_the_way": str(now.lost),
    }
    for key, pair in (("input_age_ms", now.input_age_ms), ("latency_ms", now.latency_ms)):
        if pair is not None:
            numbers[f"{key}.p50"], numbers[f"{key}.p95"] = (f"{value:.2f}" for value in pair)
    return numbers
