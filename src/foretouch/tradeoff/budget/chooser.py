# SPDX-License-Identifier: Apache-2.0
"""Choose a level for each request: down at once where the machine does not keep up, and back up with hysteresis.

The expected time of a level is that of its profile, plus what the caller needs around the prediction. The latest answers
took more or less than expected: had they been made by another level, how many would have been late? The best level is
chosen with which few more would have been than with the fastest one, so that a delay that no level avoids costs no
skill. If an idle machine would choose a better level after the usual wait, the machine is overloaded, and none is chosen
for requests of about as many grasps until it would have met the budget with a margin for a second; a request that
waited unusually long is answered faster alone. The least time between receipt and choice so far, among requests of
about as many grasps, is that of an idle machine: the rest was spent in a queue.
"""

from __future__ import annotations

import threading
import time
from bisect import bisect_right
from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from foretouch.tradeoff.budget.levels import Level
from foretouch.tradeoff.budget.profile import Profile

_MARGIN: Final = 1.2  # of the expected time, a p95
_MARGIN_UP: Final = 1.4  # the same, to return to a better level
_HOLD_S: Final = 1.0  # for which a better level must meet the budget before it is chosen
_LATEST: Final = 8  # answers of any size, from which a change is noticed at once...
_LATEST_MORE: Final = 1  # ...if more than so many of them would be late by a level, but not by the fastest
_PAST_S: Final = 3.0  # within which answers of about as many grasps show how much times vary
_PAST: Final = 100  # of them at most
_PAST_MORE: Final = 2  # as of the latest
_GUARD_S: Final = 2e-4  # before the end of the budget, from which an answer counts as late: until it is handed over
_WAITS: Final = 10  # requests, before which the least wait says nothing
_ADDED_S: Final = 2e-3  # to all times that are compared: delays are neither a factor nor a term, but between the two
_KNOWN: Final = 10_000  # numbers of grasps whose times are kept


@dataclass(frozen=True)
class Answer:
    """A request that is being answered."""

    level: Level  # by which
    reduced: bool  # whether it is less than the model itself
    count: int  # number of grasps
    arrived: float  # time of receipt [s]
    began: float  # time of the choice [s]
    expected_s: float  # time from there to the end, by the profile
    affordable: bool  # whether a level meets the budget on the machine as it was profiled


@dataclass(frozen=True)
class _Slowness:
    """Of an answer."""

    at: float  # when it ended [s]
    ratio: float  # its time over the expected, with `_ADDED_S` to both


@dataclass
class _Size:
    """What is known of requests of about as many grasps: many may need a cheaper level where few do not."""

    waits: list[float] = field(default_factory=list)  # the first ones, and the least [s]
    waited: deque[float] = field(default_factory=lambda: deque(maxlen=_LATEST))  # the latest [s]
    past: deque[_Slowness] = field(default_factory=lambda: deque(maxlen=_PAST))  # the latest
    floor: int = 0  # place of the best level that may be chosen
    better_since: float | None = None  # when a better level began to meet the budget with a margin [s]
    better: int = 0  # the worst place since then

    def wait(self, waited: float) -> float:
        """Note how long a request waited; how long the latest did in the median [s]."""
        self.waits.append(waited)
        if len(self.waits) > _WAITS:
            self.waits.remove(max(self.waits))
        self.waited.append(waited)
        return sorted(self.waited)[(len(self.waited) - 1) // 2]

    def rise(self, better: int, now: float) -> None:
        """A better level would do now; it is allowed once that has been so for long enough."""
        if better >= self.floor:
            self.better_since = None
            return
        if self.better_since is None:
            self.better_since, self.better = now, better
        self.better = max(self.better, better)
        if now - self.better_since >= _HOLD_S:
            self.floor, self.better_since = self.better, None


class LatencyBudget:
    """Chooses the level of each request. Thread-safe.

    Args:
        budget_s: From the receipt of a request to its answer [s].
        levels: The best first.
        profile: Times of the levels.
        around: By number of grasps, ascending, what a caller needs around a prediction [s].
        now: Clock [s].
    """

    def __init__(
        self,
        budget_s: float,
        levels: Sequence[Level],
        profile: Profile,
        around: Mapping[int, float] | None = None,
        now: Callable[[], float] = time.monotonic,
    ) -> None:
        self.budget_s = budget_s
        self._levels = tuple(levels)
        self._profile = profile
        self._around = dict(around or {1: 0.0})
        self._now = now
        self._lock = threading.Lock()
        self._latest: deque[_Slowness] = deque(maxlen=_LATEST)
        self._sizes: dict[int, _Size] = {}  # by digits of the number of grasps
        self._overloaded = False
        self._known: dict[int, tuple[float, ...]] = {}
        self._counts: Counter[str] = Counter()
        self._last = ""

    def expected_s(self, level: Level, count: int) -> float:
        """Time of an answer on the machine as it was profiled [s]."""
        return self._expected(count)[self._levels.index(level)]

    def affordable(self, count: int) -> Level | None:
        """The best level for so many grasps that meets the budget on the machine as it was profiled; None if none."""
        with self._lock:
            place = self._first(count, _MARGIN, self._left_if_idle(count))
        return None if place is None else self._levels[place]

    def begin(self, count: int, arrived: float) -> Answer:
        """Choose the level of a request of so many grasps that arrived at a time [s]."""
        began = self._now()
        waited = began - arrived
        with self._lock:
            size = self._sizes.setdefault(len(str(count)), _Size())
            usual = size.wait(waited)
            affordable = self._first(count, _MARGIN, self._left_if_idle(count))
            expected = self._expected(count)
            idle = _fastest(expected) if affordable is None else affordable
            answered = self._since(began - _PAST_S, size)
            place, steady, better = (
                max(idle, _place(expected, answered, factor, self.budget_s - wait))
                for factor, wait in ((_MARGIN, waited), (_MARGIN, usual), (_MARGIN_UP, usual))
            )
            if steady > max(idle, size.floor):
                size.floor, size.better_since = steady, None
            elif size.floor > idle:
                size.rise(better, began)
            chosen = max(place, size.floor)
            level = self._levels[chosen]
            self._last, self._overloaded = level.name, chosen > idle
            expected_s = expected[chosen]
        return Answer(level, level is not self._levels[0], count, arrived, began, expected_s, affordable is not None)

    def is_over(self, answer: Answer) -> bool:
        """Whether an answer is late by now, or so close to it that it may be when it is handed over."""
        return self._now() - answer.arrived > self.budget_s - _GUARD_S

    def end(self, answer: Answer) -> bool:
        """Note the end of an answer, right before it is published, and whether it is late as by `is_over`."""
        late, ended = self.is_over(answer), self._now()
        with self._lock:
            slowness = _Slowness(ended, (ended - answer.began + _ADDED_S) / (answer.expected_s + _ADDED_S))
            self._latest.append(slowness)
            self._sizes[len(str(answer.count))].past.append(slowness)
            self._counts[answer.level.name] += 1
            self._counts["answered"] += 1
            self._counts["late"] += late
            self._counts["reduced"] += answer.reduced
            self._counts["unaffordable"] += not answer.affordable
        return late

    def notes(self) -> dict[str, str]:
        """Entries for /diagnostics."""
        with self._lock:
            counts, slow, overloaded = dict(self._counts), [one.ratio for one in self._latest], self._overloaded
        return {
            "budget_ms": f"{self.budget_s * 1e3:g}",
            "budget.level": self._last or "none yet",
            "budget.overloaded": str(overloaded).lower(),
            "budget.slowdown": f"{np.median(slow or 1.0):.2f}",
            **{f"budget.{name}": str(counts.get(name, 0)) for name in ("answered", "late", "reduced", "unaffordable")},
            **{f"budget.by.{one.name}": str(counts[one.name]) for one in self._levels if one.name in counts},
            "budget.profile": f"{self._profile.origin} ({self._profile.state})",
        }

    def _expected(self, count: int) -> tuple[float, ...]:
        """Time of an answer by each level [s]."""
        found = self._known.get(count)
        if found is None:
            around = float(np.interp(count, list(self._around), list(self._around.values())))
            around *= max(1.0, count / max(self._around))
            found = tuple(self._profile.seconds(level.name, count) + around for level in self._levels)
            if len(self._known) < _KNOWN:
                self._known[count] = found
        return found

    def _left_if_idle(self, count: int) -> float:
        size = self._sizes.get(len(str(count)))
        return self.budget_s - (min(size.waits) if size is not None and len(size.waits) >= _WAITS else 0.0)

    def _first(self, count: int, factor: float, left: float) -> int | None:
        return next((k for k, seconds in enumerate(self._expected(count)) if factor * seconds <= left), None)

    def _since(self, time_s: float, size: _Size) -> tuple[list[float], list[float]]:
        """How slow the latest answers were, and those of about as many grasps, since a time; each ascending."""
        latest, past = (
            sorted(one.ratio for one in answers if one.at >= time_s) for answers in (self._latest, size.past)
        )
        return latest, past


def _fastest(expected: Sequence[float]) -> int:
    return expected.index(min(expected))


def _place(
    expected: Sequence[float], answered: tuple[Sequence[float], Sequence[float]], factor: float, left: float
) -> int:
    """The best level with which few more of the latest answers would have been late than with the fastest."""
    fastest = _fastest(expected)
    bounds = [(left + _ADDED_S) / (factor * seconds + _ADDED_S) for seconds in expected]  # of what is in time
    latest, past = answered
    in_time = bisect_right(latest, bounds[fastest])
    if bounds[fastest] < 1.0 or 2 * in_time < len(latest):  # nothing helps, except to have done with it
        return fastest
    enough, enough_past = in_time - _LATEST_MORE, bisect_right(past, bounds[fastest]) - _PAST_MORE
    return next(
        place
        for place, bound in enumerate(bounds)
        if (bound >= 1.0 or place == fastest)
        and bisect_right(latest, bound) >= enough
        and bisect_right(past, bound) >= enough_past
    )
