# SPDX-License-Identifier: Apache-2.0
"""How long each level of a model takes on this machine: measured once, and kept in the user's cache folder."""

from __future__ import annotations

import importlib.metadata
import json
import os
import platform
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np

from foretouch import __version__
from foretouch.checked_files import read_json
from foretouch.errors import FileError
from foretouch.experiments.framework.manifest import environment
from foretouch.models.card import write_text
from foretouch.models.touch_model import TouchModel
from foretouch.tradeoff.area import Timed
from foretouch.tradeoff.budget.levels import Level
from foretouch.tradeoff.timing import MachineLoad, time_variants
from foretouch.types import Cloud, Grasp

_FORMAT: Final = "foretouch-profile"
_VERSION: Final = 2  # 1: without pauses between the calls
_REQUESTS: Final = (1, 10, 100, 1000)
_POINTS: Final = 3000  # of the object, about the median of the public clouds
_SPREAD: Final = 1.25  # p95 over median on an idle machine
_LIBRARIES: Final = ("numpy", "scipy", "torch")

PAUSE_S: Final = 0.02
"""Time asleep before what is timed, as between the clouds of a camera [s]."""


@dataclass(frozen=True)
class Profile:
    """Times of the levels of one model on one machine.

    Attributes:
        times: By level, the p95 [s] for each number of grasps.
        state: `idle` or `loaded`, as the machine was.
        origin: Where they are from, in words.
    """

    times: Mapping[str, Mapping[int, float]]
    state: str
    origin: str

    def seconds(self, level: str, count: int) -> float:
        """Time of a prediction of so many grasps [s]: linear between the measured numbers, and beyond the last two."""
        known = self.times[level]
        at, values = list(known), list(known.values())
        if count <= at[-1] or len(at) < 2:
            return float(np.interp(count, at, values))
        slope = max(0.0, (values[-1] - values[-2]) / (at[-1] - at[-2]))
        return values[-1] + slope * (count - at[-1])


def fingerprint(levels: Sequence[Level]) -> dict[str, Any]:
    """What times depend on: machine, versions, and the model with its levels."""
    machine = environment(1, None)
    return {
        "cpu": machine["cpu"],
        "cores": machine["cores"],
        "machine": platform.machine(),
        "foretouch": __version__,
        "python": platform.python_version(),
        **{name: importlib.metadata.version(name) for name in _LIBRARIES},
        "model": levels[0].model.sha256,
        "levels": [level.name for level in levels],
    }


def profile_path(levels: Sequence[Level]) -> Path:
    """The file of a model's profile."""
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return cache / "foretouch" / f"profile-{levels[0].model.sha256[:16]}.json"


def load_profile(
    levels: Sequence[Level],
    *,
    seconds: float = 10.0,
    again: bool = False,
    say: Callable[[str], None] = lambda _: None,
    progress: Callable[[int, int], None] = lambda *_: None,
) -> Profile:
    """The kept profile of a model, or a new one where there is none, or it is of another machine, version or model.

    Args:
        levels: Of the model.
        seconds: Time of a measurement; each level and number of grasps gets five calls at least [s].
        again: Measure in any case.
        say: Called with a line on why it is measured, and on a file that cannot be written; the profile then holds
            until the process ends.
        progress: As that of `time_variants`.
    """
    path, own = profile_path(levels), fingerprint(levels)
    if not again:
        try:
            return _read(path, own)
        except FileError as err:
            say(f"budget: {err}: measuring how long predictions take here, once")
    times, state = _measure(levels, seconds, progress)
    document = {"format": _FORMAT, "format_version": _VERSION, "fingerprint": own, "state": state, "p95_s": times}
    try:
        write_text(path, json.dumps(document, indent=1) + "\n")
    except FileError as err:
        say(f"budget: {err}: the profile is kept in memory, until the end of this process")
        return Profile(times, state, "measured now, and not kept")
    return Profile(times, state, str(path))


def _read(path: Path, own: Mapping[str, Any]) -> Profile:
    """Read a profile of this machine, version and model; a `FileError` names what differs."""
    if not path.exists():
        raise FileError(path, "there is no profile yet")
    document = read_json(path)
    if not isinstance(document, dict) or (document.get("format"), document.get("format_version")) != (
        _FORMAT,
        _VERSION,
    ):
        raise FileError(path, f"is no {_FORMAT} of version {_VERSION}")
    found = document.get("fingerprint")
    found = found if isinstance(found, dict) else {}
    for name, value in own.items():
        if found.get(name) != value:
            raise FileError(path, f"is of {found.get(name)!r}, not of {value!r}", field=name)
    try:
        times = {
            name: {int(count): float(value) for count, value in document["p95_s"][name].items()}
            for name in own["levels"]
        }
    except (KeyError, TypeError, ValueError, AttributeError) as err:
        raise FileError(path, f"holds no times of a level: {err}", field="p95_s") from err
    if not all(one and np.isfinite(list(one.values())).all() and min(one.values()) > 0.0 for one in times.values()):
        raise FileError(path, "a time is not above 0 and finite", field="p95_s")
    return Profile(
        {name: dict(sorted(one.items())) for name, one in times.items()}, str(document.get("state")), str(path)
    )


def _measure(
    levels: Sequence[Level], seconds: float, progress: Callable[[int, int], None]
) -> tuple[dict[str, dict[int, float]], str]:
    cloud, grasps = profile_scene(_REQUESTS[-1])

    def answer(model: TouchModel, count: int) -> Any:
        return model.predict(cloud, grasps[:count])

    timed = {level.name: Timed(partial(answer, level.model)) for level in levels}
    load = MachineLoad()
    rows = time_variants(timed, _REQUESTS, seconds, 0, progress, PAUSE_S)
    state = str(load.row()["state"])
    times: dict[str, dict[int, float]] = {level.name: {} for level in levels}
    for row in rows:
        # Other processes delay calls, but cost little processor time: of that, a p95 would be so much more.
        milliseconds = row["ms_p95"] if state == "idle" else _SPREAD * row["cpu_ms"]
        times[row["variant"]][row["request"]] = milliseconds / 1e3
    return times, state


def profile_scene(count: int) -> tuple[Cloud, list[Grasp]]:
    """A can of 3000 points on a table below the camera, and grasps across it."""
    rng = np.random.default_rng(0)
    angle, along = rng.uniform(0.0, np.pi, _POINTS), rng.uniform(-0.055, 0.055, _POINTS)
    xyz = np.column_stack([along, 0.035 * np.cos(angle), 1.15 - 0.035 * np.sin(angle)])
    cloud = Cloud((xyz + rng.normal(0.0, 5e-4, xyz.shape)).astype(np.float32))
    place = rng.uniform(-0.04, 0.04, count)
    turned = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]).T  # z across the can
    return cloud, [Grasp(np.array([x, 0.034, 1.148]), np.array([x, -0.034, 1.148]), turned) for x in place]
