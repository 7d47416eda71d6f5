# SPDX-License-Identifier: Apache-2.0
"""What a node reports in /diagnostics: its state, rate, ages and latencies, and what became of every input.

The package `diagnostic_updater` of ROS makes such reports, but it is not on PyPI.
"""

import threading
import time
from collections import Counter, deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue

_WINDOW: Final = 300  # latest inputs for quantiles: ten seconds at 30 Hz
_RATE_S: Final = 10.0  # latest time for rates


@dataclass
class Report:
    """One report of a node, to which each part of it adds."""

    errors: list[str] = field(default_factory=list)  # what keeps the node from working
    warnings: list[str] = field(default_factory=list)  # what the operator should know although the node works
    values: dict[str, str] = field(default_factory=dict)  # all else, by key

    def to_msg(self, name: str, fine: str) -> DiagnosticStatus:
        """Convert to the message of a node.

        Args:
            name: Full name of the node.
            fine: Text where nothing is wrong.
        """
        level = (
            DiagnosticStatus.ERROR if self.errors else DiagnosticStatus.WARN if self.warnings else DiagnosticStatus.OK
        )
        text = "; ".join(self.errors or self.warnings) or fine
        values = [KeyValue(key=key, value=value) for key, value in self.values.items()]
        return DiagnosticStatus(level=level, name=name, message=text, hardware_id="none", values=values)


@dataclass(frozen=True, kw_only=True)
class InputSummary:
    """Counts since the start, received = used + sum(dropped) + waiting, and quantiles over the latest inputs."""

    received: int  # inputs that arrived; messages of several topics that belong to one cloud are one input
    used: int  # inputs that were answered
    dropped: Mapping[str, int]  # inputs that will not be answered, by reason
    waiting: int  # inputs not yet answered
    lost: int  # messages that the middleware lost before they arrived; not part of `received`
    rate_hz: float  # answers per second over the latest ten seconds
    input_age_ms: tuple[float, float] | None  # p50 and p95 from the stamp of an input to the start of the work
    latency_ms: tuple[float, float] | None  # p50 and p95 from arrival to publication; None before the first
    idle_s: float | None  # time since the last arrival; None before the first


class InputStatistics:
    """Counts inputs and keeps the latest times. Thread-safe."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._received = self._used = self._lost = 0
        self._dropped: Counter[str] = Counter()
        self._reported: Counter[str] = Counter()  # drops and losses that are in the reports so far
        self._ages: deque[float] = deque(maxlen=_WINDOW)
        self._latencies: deque[float] = deque(maxlen=_WINDOW)
        self._answers: deque[float] = deque(maxlen=2 * _WINDOW)
        self._last_arrival: float | None = None

    def receive(self) -> float:
        """Count an input and return its time of arrival, `time.monotonic` [s]."""
        now = time.monotonic()
        with self._lock:
            self._received += 1
            self._last_arrival = now
        return now

    def use(self, arrived: float, input_age_s: float) -> None:
        """Count an answer to an input.

        Args:
            arrived: When the input arrived, by `time.monotonic` [s].
            input_age_s: Time from its stamp to the start of the work [s].
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
            recent = [answered for answered in self._answers if now - answered < _RATE_S]
            span = now - recent[0] if recent else 0.0
            return InputSummary(
                received=self._received,
                used=self._used,
                dropped=dropped,
                waiting=self._received - self._used - sum(dropped.values()),
                lost=self._lost,
                rate_hz=len(recent) / span if span > 0.0 else 0.0,
                input_age_ms=_quantiles(self._ages),
                latency_ms=_quantiles(self._latencies),
                idle_s=None if self._last_arrival is None else now - self._last_arrival,
            )

    def add_to(self, report: Report, silence_s: float | None) -> None:
        """Report all numbers, and what was dropped since the last report as a warning.

        Args:
            report: Extended.
            silence_s: Time without an input that is a warning [s]; None where no input is expected.
        """
        now = self.summary()
        if silence_s is not None and (now.idle_s is None or now.idle_s > silence_s):
            report.warnings.append("no input yet" if now.idle_s is None else f"no input for {now.idle_s:.1f} s")
        lost = Counter({**now.dropped, "lost in transport": now.lost})
        if recent := lost - self._reported:
            counts = ", ".join(f"{count} {reason}" for reason, count in recent.items())
            report.warnings.append(f"dropped since the last report: {counts}")
        self._reported = lost
        numbers = {"received": now.received, "used": now.used, "dropped": sum(now.dropped.values())}
        numbers |= {f"dropped.{reason}": count for reason, count in sorted(now.dropped.items())}
        numbers |= {"waiting": now.waiting, "lost_on_the_way": now.lost}
        report.values |= {"rate_hz": f"{now.rate_hz:.2f}", **{key: str(number) for key, number in numbers.items()}}
        for key, pair in (("input_age_ms", now.input_age_ms), ("latency_ms", now.latency_ms)):
            if pair is not None:
                report.values |= {f"{key}.p50": f"{pair[0]:.2f}", f"{key}.p95": f"{pair[1]:.2f}"}


def _quantiles(values: deque[float]) -> tuple[float, float] | None:
    if not values:
        return None
    middle, high = np.percentile(np.asarray(values), (50, 95))
    return float(middle), float(high)
