# SPDX-License-Identifier: Apache-2.0
"""What a node reports in /diagnostics: its state, rate, ages and latencies, and what became of every input."""

import threading
import time
from collections import Counter, deque
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue

_WINDOW = 300  # latest inputs for quantiles and rates: ten seconds at 30 Hz


@dataclass(frozen=True, kw_only=True)
class InputSummary:
    """Counts since the start, received = used + sum(dropped) + waiting, and quantiles over the latest inputs.

    Attributes:
        received: Inputs that arrived; messages of several topics that belong to one cloud are one input.
        used: Inputs that were answered.
        dropped: Inputs that will not be answered, by reason.
        waiting: Inputs not yet answered.
        lost: Messages that the middleware lost before they arrived; not part of `received`.
        rate_hz: Answers per second over the latest inputs [Hz].
        input_age_ms: p50 and p95 from the stamp of an input to the start of the work [ms]; None before the first.
        latency_ms: p50 and p95 from arrival to publication [ms]; None before the first.
        idle_s: Time since the last arrival [s]; None before the first.
    """

    received: int
    used: int
    dropped: Mapping[str, int] = field(default_factory=dict)
    waiting: int
    lost: int
    rate_hz: float
    input_age_ms: tuple[float, float] | None
    latency_ms: tuple[float, float] | None
    idle_s: float | None


class InputStatistics:
    """Counts inputs and keeps the latest times. Thread-safe."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._received = 0
        self._used = 0
        self._dropped: Counter[str] = Counter()
        self._lost = 0
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
        """Count an answer.

        Args:
            arrived: What `receive` returned [s].
            input_age_s: From the stamp of the input to the start of the work [s].
        """
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


@dataclass(frozen=True, kw_only=True)
class NodeStatus:
    """What a node reports beyond its counts.

    Attributes:
        state: Lifecycle state.
        errors: What keeps it from working, such as a damaged model.
        warnings: Problems around it, such as incompatible QoS.
        notes: Further values by key, such as the model's name.
        expects_input_every_s: A longer time without an input is a warning [s]; None for a node without inputs.
    """

    state: str
    errors: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    notes: Mapping[str, str] | None = None
    expects_input_every_s: float | None = None


def diagnostic_status(name: str, now: InputSummary, before: InputSummary | None, node: NodeStatus) -> DiagnosticStatus:
    """Make the report of one node: a level, one line of text, and all numbers; drops since `before` are a warning."""
    warnings = [*node.warnings, *_silence(now, node), *_drops(now, before)]
    if node.errors:
        level, message = DiagnosticStatus.ERROR, "; ".join(node.errors)
    elif warnings:
        level, message = DiagnosticStatus.WARN, "; ".join(warnings)
    else:
        level, message = DiagnosticStatus.OK, f"{node.state}, {now.rate_hz:.1f} Hz"
    values = {"state": node.state, **_numbers(now), **(node.notes or {})}
    return DiagnosticStatus(
        level=level,
        name=name,
        message=message,
        hardware_id="none",
        values=[KeyValue(key=key, value=value) for key, value in values.items()],
    )


def _silence(now: InputSummary, node: NodeStatus) -> list[str]:
    limit = node.expects_input_every_s
    if limit is None or node.state != "active":
        return []
    if now.idle_s is None:
        return ["no input yet"]
    return [f"no input for {now.idle_s:.1f} s"] if now.idle_s > limit else []


def _drops(now: InputSummary, before: InputSummary | None) -> list[str]:
    old = before.dropped if before else {}
    recent = {reason: count - old.get(reason, 0) for reason, count in now.dropped.items()}
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
