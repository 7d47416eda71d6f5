# SPDX-License-Identifier: Apache-2.0
"""The grasps of a dataset so far, and what is worth recording next by docs/recording_protocol.md.

That is a tare before each object, ten grasps a visit of which the tenth repeats the ninth, and each object again on another
day; besides, the widths and places of grasps that were planned on an object and never executed.
"""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from datetime import datetime
from functools import lru_cache
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from foretouch.dataset.record import DISCARDED, SampleRecord
from foretouch.dataset.recording.edits import EditLog
from foretouch.dataset.recording.reader import RecordedDataset
from foretouch.errors import ForetouchError
from foretouch.types import Float64

TARE_S: Final = 2.0  # how long the fingers rest before each object [s]
VISIT_GRASPS: Final = 10  # grasps on an object until the next one is laid on the table
DROPPED: Final = "dropped"  # instead of an outcome


class GraspSummary(NamedTuple):
    """What is kept of a sample."""

    object: str
    outcome: str  # or `DROPPED`
    touched: bool
    day: str
    spots: frozenset[str]  # width and place of the grasp
    planned: frozenset[str]  # those of all grasps that were planned on the cloud

    @property
    def counts(self) -> bool:
        """Whether it was executed and is used."""
        return self.touched and self.outcome != DROPPED


def summarise(record: SampleRecord) -> GraspSummary:
    """Summarise a sample as it was recorded; places are those that the camera sees."""
    sample, grasps = record.sample, (record.sample.grasp, *record.candidates)
    low, high = np.percentile(sample.cloud.xyz.reshape(-1, 3)[:, :2], (5.0, 95.0), axis=0)
    scale = np.maximum(high - low, 1e-6)
    spots = [
        frozenset((_width(float(np.linalg.norm(one.g1 - one.g2))), _place((one.midpoint[:2] - low) / scale - 0.5)))
        for one in grasps
    ]
    outcome = DROPPED if DISCARDED in record.flags else record.outcome
    day = str(datetime.fromtimestamp(sample.stamp_ns * 1e-9).astimezone().date())
    kept = (sample.object, day, spots[0], frozenset().union(*spots))
    name, day, spot, planned = (_shared(one) for one in kept)
    return GraspSummary(name, outcome, sample.touch is not None, day, spot, planned)


@lru_cache(maxsize=4096)
def _shared(value: Any) -> Any:
    """The first of equal values: thousands of samples share a few."""
    return value


def summarise_dataset(path: Path) -> dict[str, GraspSummary]:
    """The grasps of a dataset by id as recorded; none if it cannot be read."""
    with suppress(ForetouchError, OSError):
        dataset = RecordedDataset(path)
        records = (dataset.as_recorded(k).record for k in range(len(dataset)))
        return {record.sample.id: summarise(record) for record in records}
    return {}


def edited(grasps: Mapping[str, GraspSummary], edits: EditLog) -> dict[str, GraspSummary]:
    """The grasps with the edits applied; the keys stay the ids as recorded."""
    found = {}
    for recorded, one in grasps.items():
        label, outcome, _, dropped = edits.changes(recorded)
        changed = (label or one.object, DROPPED if dropped else outcome or one.outcome)
        found[recorded] = one if changed == one[:2] else one._replace(object=changed[0], outcome=changed[1])
    return found


def count_outcomes(grasps: Iterable[GraspSummary], plan: Sequence[str] = ()) -> dict[str, Counter[str]]:
    """Executed grasps by object and outcome; those of the plan first."""
    found: dict[str, Counter[str]] = {name: Counter() for name in plan}
    for one in grasps:
        if one.touched:
            found.setdefault(one.object, Counter())[one.outcome] += 1
    return found


def suggest(
    grasps: Sequence[GraspSummary], plan: Sequence[str], current: str, visited: int, *, tared: bool
) -> list[str]:
    """What is worth doing next, a line each, the most urgent first.

    Args:
        grasps: Of the dataset, with the edits applied.
        plan: Objects that are to be recorded.
        current: The object on the table.
        visited: Grasps on it that are used since it was laid there.
        tared: Whether the fingers have rested since for `TARE_S`.
    """
    steps = [] if tared else [f"tare: keep the fingers open and still for {TARE_S:g} s"]
    if visited >= VISIT_GRASPS:
        steps.append(f"{visited} grasps on {current} in this visit: next object")
    elif visited == VISIT_GRASPS - 1:
        steps.append("repeat the last grasp; leave the object where it is")
    else:
        steps.append(f"grasp {visited + 1} of {VISIT_GRASPS} on {current}")
    own = [one for one in grasps if one.object == current and one.outcome != DROPPED]
    missing = set().union(*(one.planned for one in own)) - set().union(*(one.spots for one in own if one.touched))
    if missing:
        steps.append(f"planned on {current}, not touched yet: {', '.join(sorted(missing))}")
    days: dict[str, list[str]] = {name: [] for name in (*plan, *(one.object for one in grasps))}
    for one in filter(lambda one: one.counts, grasps):
        days[one.object].append(one.day)
    if few := sorted((len(n), name) for name, n in days.items() if len(n) < VISIT_GRASPS and name != current):
        steps.append(f"few grasps: {_listed([f'{name} {count}' for count, name in few])}")
    elif once := [name for name, found in days.items() if len(found) >= VISIT_GRASPS and len(set(found)) == 1]:
        steps.append(f"again on another day: {_listed(once)}")
    return steps


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names[:4]) + (f" and {len(names) - 4} more" if len(names) > 4 else "")


def _width(width_m: float) -> str:
    low_mm = 10 * int(100.0 * width_m)
    return f"{low_mm}–{low_mm + 10} mm"


def _place(offset: Float64) -> str:
    """Where a grasp lies on the object, by its offset from the middle in x and y of the image, from -0.5 to 0.5."""
    x, y = map(float, offset)
    if max(abs(x), abs(y)) < 1.0 / 6.0:
        return "middle"
    return ("left" if x < 0.0 else "right") if abs(x) > abs(y) else ("top" if y < 0.0 else "bottom")
