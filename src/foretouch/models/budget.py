# SPDX-License-Identifier: Apache-2.0
"""Predictions within a time: for each request the most accurate level of a model that meets it on this machine.

Levels of a model are itself and cheaper forms of it, which need no training. `levels.json` names models by their hash
and holds for each level the skill on held-out blocks of time, and by how much its errors exceed those of the model, by
which its intervals are widened; `benchmarks/budget/levels.py` writes it. The last level is the mean of the training
labels, which looks at no cloud: its predictions are flagged `unfamiliar` and have the intervals of a new object.

How long each level takes here is measured at the start, by level and number of grasps. The latest answers show how much slower the machine is at present: a level is expected to take as much longer as all but one of them did.
"""

import json
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib import resources
from typing import Any, Final, TypeAlias

import numpy as np

from foretouch.models.contact.estimator import fewer_trees
from foretouch.models.timing import time_calls
from foretouch.models.touch_model import Estimate, Estimator, TouchModel
from foretouch.tactile import Ranges
from foretouch.types import Cloud, Float64, Grasp, Plane

_COUNTS: Final = (1, 10, 100, 1000)  # grasps of the requests that are timed
_POINTS: Final = 3000  # of the object, about the median of the public clouds
_MEASURED_S: Final = 3.0  # how long all of them are timed [s]

_ADDED_S: Final = 2e-3  # to times whose ratio is taken: a delay is neither a factor nor a term, but between the two [s]

PAUSE_S: Final = 0.02
"""Time asleep before what is timed, as between the clouds of a camera [s]."""


@dataclass(frozen=True, eq=False)
class Level:
    """One way to predict by a model."""

    name: str
    skill: float | None  # mean skill on held-out blocks of time; None if it is not known
    model: TouchModel  # predicts in this way


@dataclass(frozen=True, eq=False)
class _Mean:
    """Predicts the mean of the training labels for every grasp."""

    mean: Float64  # (D,) [counts]
    ranges: Ranges

    def estimate(self, _: Cloud, grasps: Sequence[Grasp], _table: Plane | None = None) -> Estimate:
        return Estimate(np.tile(self.mean, (len(grasps), 1)), np.zeros(len(grasps), np.bool_))


_MAKERS: Final[dict[str, Callable[[Any], Estimator]]] = {
    "10 trees": lambda one: fewer_trees(one, 10),
    "no surroundings": lambda one: replace(one, surroundings=False),
}
"""Estimators of the levels by name, from the model's own."""


def levels_of(model: TouchModel) -> list[Level]:
    """The levels of a model, itself first, then by descending skill; the mean of its labels last.

    A model that `levels.json` does not name has itself and this mean.
    """
    file = resources.files("foretouch.models") / "levels.json"
    known: dict[str, Any] = json.loads(file.read_text("utf-8")).get(model.sha256, {}).get("levels", {})
    levels = [Level(model.name, known.get(model.name, {}).get("skill"), model)]
    for name, entry in sorted(known.items(), key=lambda item: -item[1]["skill"]):
        if name in _MAKERS:
            reduced = model.reduced(_MAKERS[name](model.estimator), model.sensor.channels.by_modality(entry["widen"]))
            levels.append(Level(name, entry["skill"], reduced))
    mean = getattr(model.estimator, "mean", None)
    if isinstance(mean, np.ndarray):
        reduced = model.reduced(_Mean(mean, model.ranges), np.ones(len(mean)))
        levels.append(Level("mean of labels", 0.0 if known else None, reduced))
    return levels


Times: TypeAlias = Mapping[str, Mapping[int, float]]
"""By level, p95 for each number of grasps, ascending, without waits [s]."""


def _interpolated(times: Mapping[int, float], count: int) -> float:
    """Linear between the numbers of grasps that were timed, and beyond the last two; never below 0."""
    at, values = list(times), list(times.values())
    if count <= at[-1] or len(at) < 2:
        return float(np.interp(count, at, values))
    return values[-1] + max(0.0, (values[-1] - values[-2]) / (at[-1] - at[-2])) * (count - at[-1])


def load_warm(model: TouchModel) -> tuple[list[Level], Times]:
    """The levels of a model, and how long they take on this machine, measured in some seconds."""
    levels = levels_of(model)
    return levels, _measure(levels)


def _measure(levels: Sequence[Level]) -> Times:
    cloud, grasps = profile_scene(_COUNTS[-1])
    functions = {one.name: lambda count, one=one: one.model.predict(cloud, grasps[:count]) for one in levels}
    times: dict[str, dict[int, float]] = {one.name: {} for one in levels}
    for (name, count), calls in time_calls(functions, _COUNTS, _MEASURED_S, pause_s=PAUSE_S).items():
        # Of a call that waits for a core, the processor time is the lesser.
        times[name][count] = float(np.percentile(calls.min(axis=1), 95))
    return times


def profile_scene(count: int) -> tuple[Cloud, Sequence[Grasp]]:
    """A can of 3000 points on a table below the camera, and grasps across it."""
    rng = np.random.default_rng(0)
    angle, along = rng.uniform(0.0, np.pi, _POINTS), rng.uniform(-0.055, 0.055, _POINTS)
    xyz = np.column_stack([along, 0.035 * np.cos(angle), 1.15 - 0.035 * np.sin(angle)])
    cloud = Cloud((xyz + rng.normal(0.0, 5e-4, xyz.shape)).astype(np.float32))
    place = rng.uniform(-0.04, 0.04, count)
    turned = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])  # z across the can
    return cloud, [Grasp(np.array([x, 0.034, 1.148]), np.array([x, -0.034, 1.148]), turned) for x in place]


@dataclass(frozen=True)
class Answer:
    """A request that is being answered."""

    level: Level  # by which
    reduced: bool  # whether it is less than the model itself
    arrived: float  # time of receipt [s]
    began: float  # time of the choice [s]
    expected_s: float  # time from there to the end, by the profile
    affordable: bool  # whether a level meets the budget on the machine as it was profiled


@dataclass(eq=False)
class LatencyBudget:
    """Chooses the level of each request. Thread-safe."""

    budget_s: float  # from the receipt of a request to its answer [s]
    levels: Sequence[Level]  # the best first
    times: Times  # of the levels
    # By number of grasps, ascending, what a caller needs around a prediction [s].
    around: Mapping[int, float] = field(default_factory=lambda: {1: 0.0})
    now: Callable[[], float] = time.monotonic  # clock [s]
    _lock: threading.Lock = field(default_factory=threading.Lock, init=False)
    # The least so far between receipt and choice [s], by digits of the number.
    _waits: dict[int, float] = field(default_factory=dict, init=False)
    # When each of the latest answers ended [s], and how slow it was; those of the last 3 s count.
    _recent: deque[tuple[float, float]] = field(default_factory=lambda: deque(maxlen=100), init=False)
    _counts: Counter[str] = field(
        default_factory=lambda: Counter(answered=0, late=0, reduced=0, unaffordable=0), init=False
    )
    _last: str = field(default="none yet", init=False)

    def affordable(self, count: int) -> Level | None:
        """The best level for so many grasps that meets the budget on the machine as it was profiled; None if none."""
        expected, left = self._expected(count), self.budget_s - self._waits.get(len(str(count)), 0.0)
        return next((level for level, seconds in zip(self.levels, expected, strict=True) if seconds <= left), None)

    def begin(self, count: int, arrived: float) -> Answer:
        """Choose the level of a request of so many grasps that arrived at a time [s]."""
        began, expected = self.now(), self._expected(count)
        waited, digits = began - arrived, len(str(count))
        with self._lock:
            least = self._waits[digits] = min(waited, self._waits.get(digits, waited))
            recent = sorted(ratio for ended, ratio in self._recent if ended > began - 3.0)
            place = _best(expected, self.budget_s - waited, recent)
            level = self.levels[place]
            self._last = level.name
        return Answer(level, place > 0, arrived, began, expected[place], min(expected) <= self.budget_s - least)

    def is_over(self, answer: Answer) -> bool:
        """Whether an answer is late by now, or so close to it that it may be when it is handed over."""
        return self.now() - answer.arrived > self.budget_s - 2e-4  # [s], for handing it over

    def end(self, answer: Answer) -> bool:
        """Note the end of an answer, right before it is published, and whether it is late as by `is_over`."""
        late, ended = self.is_over(answer), self.now()
        with self._lock:
            self._recent.append((ended, (ended - answer.began + _ADDED_S) / (answer.expected_s + _ADDED_S)))
            flags = {"late": late, "reduced": answer.reduced, "unaffordable": not answer.affordable}
            self._counts.update({f"by.{answer.level.name}": 1, "answered": 1, **flags})
        return late

    def notes(self) -> dict[str, str]:
        """Entries for /diagnostics."""
        with self._lock:
            counts = {f"budget.{name}": str(count) for name, count in self._counts.items()}
            return {"budget_ms": f"{self.budget_s * 1e3:g}", "budget.level": self._last, **counts}

    def _expected(self, count: int) -> list[float]:
        """Time of an answer by each level [s]."""
        around = _interpolated(self.around, count)
        return [_interpolated(self.times[level.name], count) + around for level in self.levels]


def _best(expected: Sequence[float], left: float, recent: Sequence[float] = ()) -> int:
    """Place of the best level that meets a time, else of the fastest.

    Args:
        expected: Time of each level, the best first [s].
        left: The time [s].
        recent: Ascending, how slow the latest answers were. One may be late. Those that would have been late by the
            fastest level too do not count, unless they are the most of them: then nothing helps but to be done early.
    """
    fastest = min(range(len(expected)), key=expected.__getitem__)
    bounds = [(left + _ADDED_S) / (seconds + _ADDED_S) for seconds in expected]
    avoidable = [ratio for ratio in recent if ratio <= bounds[fastest]]
    if 2 * len(avoidable) < len(recent):
        return fastest
    slowness = max(1.0, avoidable[-2]) if len(avoidable) > 1 else 1.0
    return next((place for place, bound in enumerate(bounds) if slowness <= bound), fastest)
