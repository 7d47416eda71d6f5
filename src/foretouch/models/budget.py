# SPDX-License-Identifier: Apache-2.0
"""Predictions within a time: for each request the most accurate level of a model that meets it on this machine.

Levels of a model are itself and cheaper forms of it, which need no training. `levels.json` names models by their hash
and holds for each level the skill on held-out blocks of time, and by how much its errors exceed those of the model, by
which its intervals are widened; `benchmarks/budget/levels.py` writes it. The last level is the mean of the training
labels, which looks at no cloud: its predictions are flagged `unfamiliar` and have the intervals of a new object.

How long each level takes here is measured once and kept in the user's cache folder, as a `Profile`. The latest answers
show how much slower the machine is at present: a level is expected to take as much longer as all but one of them did.
"""

import importlib.metadata
import json
import os
import platform
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import Any, Final

import numpy as np

from foretouch import __version__
from foretouch.errors import FileError, shown
from foretouch.files import read_json, write_text
from foretouch.models.contact.cheaper import GlobalFeaturesOnly, fewer_trees
from foretouch.models.registry import load_model
from foretouch.models.timing import MachineLoad, cpu_name, time_calls
from foretouch.models.touch_model import Estimate, Estimator, TouchModel
from foretouch.tactile import Ranges
from foretouch.types import Cloud, Float64, Grasp

_FORMAT: Final = {"format": "foretouch-profile", "format_version": 3}
_COUNTS: Final = (1, 10, 100, 1000)  # grasps of the requests that are timed
_POINTS: Final = 3000  # of the object, about the median of the public clouds
_TIMES_S: Final = (1e-7, 1e4)  # between which a prediction takes on any machine [s]
_LIBRARIES: Final = ("numpy", "scipy", "torch")

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

    def estimate(self, _: Cloud, grasps: Sequence[Grasp]) -> Estimate:
        return Estimate(np.tile(self.mean, (len(grasps), 1)), np.zeros(len(grasps), np.bool_))


_MAKERS: Final[dict[str, Callable[[Any], Estimator]]] = {
    "10 trees": lambda one: fewer_trees(one, 10),
    "no surroundings": GlobalFeaturesOnly.of,
    "touchnet-v1": lambda _: load_model("touchnet-v1").estimator,
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


@dataclass(frozen=True)
class Profile:
    """Times of the levels of one model on one machine."""

    times: Mapping[str, Mapping[int, float]]  # by level, p95 for each number of grasps, ascending, without waits [s]
    state: str  # of the machine then: `idle` or `loaded`
    origin: str  # the file, or another description


def _interpolated(times: Mapping[int, float], count: int) -> float:
    """Linear between the numbers of grasps that were timed, and beyond the last two; never below 0."""
    at, values = list(times), list(times.values())
    if count <= at[-1] or len(at) < 2:
        return float(np.interp(count, at, values))
    return values[-1] + max(0.0, (values[-1] - values[-2]) / (at[-1] - at[-2])) * (count - at[-1])


def load_warm(model: TouchModel, say: Callable[[str], object]) -> tuple[list[Level], Profile]:
    """The levels of a model with their profile (see `load_profile`); each has predicted once, so that the first cloud is not late."""
    levels = levels_of(model)
    profile = load_profile(levels, say=say)
    cloud, grasps = profile_scene(1)
    for level in levels:
        level.model.predict(cloud, grasps)
    return levels, profile


def load_profile(
    levels: Sequence[Level],
    *,
    seconds: float = 10.0,
    again: bool = False,
    say: Callable[[str], object] = lambda _: None,
    progress: Callable[[int, int], None] = lambda *_: None,
) -> Profile:
    """The kept profile of a model, or a new one where there is none, or it is of another machine, version or model.

    Args:
        levels: Of the model.
        seconds: Time of a measurement [s].
        again: Measure in any case.
        say: Called with a line on why it is measured, and on a file that cannot be written.
        progress: Called with the number of calls done and of all.
    """
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    path = cache / "foretouch" / f"profile-{levels[0].model.sha256[:16]}.json"
    own = {
        "cpu": cpu_name(),
        "cores": len(os.sched_getaffinity(0)),
        "machine": platform.machine(),
        "foretouch": __version__,
        "python": platform.python_version(),
        **{name: importlib.metadata.version(name) for name in _LIBRARIES},
        "model": levels[0].model.sha256,
        "levels": [level.name for level in levels],
    }
    try:
        if not again:
            return _read(path, own)
    except FileError as err:
        say(f"budget: {err}: measuring how long predictions take here, once")
    times, state = _measure(levels, seconds, progress)
    try:
        write_text(path, json.dumps({**_FORMAT, "fingerprint": own, "state": state, "p95_s": times}, indent=1) + "\n")
    except FileError as err:
        say(f"budget: {err}: the profile is kept in memory, until the end of this process")
        return Profile(times, state, "measured now, and not kept")
    return Profile(times, state, str(path))


def _read(path: Path, own: Mapping[str, Any]) -> Profile:
    """Read a profile of this machine, version and model; a `FileError` names what differs."""
    if not path.exists():
        raise FileError(path, "there is no profile yet")
    document = read_json(path)
    if not isinstance(document, dict) or {name: document.get(name) for name in _FORMAT} != _FORMAT:
        raise FileError(path, "is not a {format} of version {format_version}".format(**_FORMAT))
    try:
        found = document["fingerprint"]
        if differing := next((name for name in own if found.get(name) != own[name]), None):
            raise FileError(path, f"is of {found.get(differing)!r}, not of {own[differing]!r}", field=differing)
        times = {
            name: dict(sorted((int(count), value) for count, value in document["p95_s"][name].items()))
            for name in own["levels"]
        }
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as err:
        raise FileError(path, f"is damaged: {shown(str(err))}") from err
    if not all(one and all(map(_plausible, one, one.values())) for one in times.values()):
        rule = "holds no time, a time that is not a number from {:g} to {:g} s, or one of more than {:g} grasps"
        raise FileError(path, rule.format(*_TIMES_S, _COUNTS[-1]), field="p95_s")
    return Profile(times, str(document.get("state")), str(path))


def _plausible(count: int, value: Any) -> bool:
    return 0 < count <= _COUNTS[-1] and type(value) in (int, float) and _TIMES_S[0] <= value <= _TIMES_S[1]


def _measure(
    levels: Sequence[Level], seconds: float, progress: Callable[[int, int], None]
) -> tuple[dict[str, dict[int, float]], str]:
    cloud, grasps = profile_scene(_COUNTS[-1])
    functions = {one.name: lambda count, one=one: one.model.predict(cloud, grasps[:count]) for one in levels}
    load = MachineLoad()
    found = time_calls(functions, _COUNTS, seconds, progress, PAUSE_S)
    # Of a call that waits for a core, the processor time is the lesser.
    p95 = {key: float(np.percentile(calls.min(axis=1), 95)) for key, calls in found.items()}
    times = {one.name: {count: time_s for (name, count), time_s in p95.items() if name == one.name} for one in levels}
    return times, str(load.row()["state"])


def profile_scene(count: int) -> tuple[Cloud, list[Grasp]]:
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
    profile: Profile  # times of the levels
    # By number of grasps, ascending, what a caller needs around a prediction [s].
    around: Mapping[int, float] = field(default_factory=lambda: {1: 0.0})
    now: Callable[[], float] = time.monotonic  # clock [s]
    _lock: threading.Lock = field(default_factory=threading.Lock, init=False)
    # The least so far between receipt and choice [s], by digits of the number.
    _waits: dict[int, float] = field(default_factory=dict, init=False)
    # When each of the latest answers ended [s], and how slow it was; those of the last 3 s count.
    _recent: deque[tuple[float, float]] = field(default_factory=lambda: deque(maxlen=100), init=False)
    _overloaded: bool = field(default=False, init=False)
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
            idle = _best(expected, self.budget_s - least)
            level = self.levels[place]
            self._last, self._overloaded = level.name, place > idle
        return Answer(level, place > 0, arrived, began, expected[place], expected[idle] <= self.budget_s - least)

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
            slowdown = np.median([ratio for _, ratio in self._recent] or 1.0)
            return {
                "budget_ms": f"{self.budget_s * 1e3:g}",
                "budget.level": self._last,
                "budget.overloaded": str(self._overloaded).lower(),
                "budget.slowdown": f"{slowdown:.2f}",
                **{f"budget.{name}": str(count) for name, count in self._counts.items()},
                "budget.profile": f"{self.profile.origin} ({self.profile.state})",
            }

    def _expected(self, count: int) -> list[float]:
        """Time of an answer by each level [s]."""
        around = _interpolated(self.around, count)
        return [_interpolated(self.profile.times[level.name], count) + around for level in self.levels]


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
