# SPDX-License-Identifier: Apache-2.0
"""The grasps of a dataset so far, and what docs/recording_protocol.md asks for next.

That is a tare before each object, and ten grasps a visit of which the tenth repeats the ninth.
"""

import sys
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Final, NamedTuple

from foretouch.dataset.record import DISCARDED, SampleRecord
from foretouch.dataset.recording.edits import EditLog
from foretouch.errors import ForetouchError

TARE_S: Final = 2.0  # how long the fingers rest before each object [s]
VISIT_GRASPS: Final = 10  # grasps on an object until the next one is laid on the table
DROPPED: Final = "dropped"  # instead of an outcome


class GraspSummary(NamedTuple):
    """What is kept of a sample."""

    object: str
    outcome: str  # or `DROPPED`
    touched: bool

    @property
    def counts(self) -> bool:
        """Whether it was executed and is used."""
        return self.touched and self.outcome != DROPPED


def summarise(record: SampleRecord) -> GraspSummary:
    """Summarise a sample as it was recorded."""
    outcome = DROPPED if DISCARDED in record.flags else record.outcome
    return GraspSummary(sys.intern(record.sample.object), outcome, record.sample.touch is not None)


def summarise_dataset(path: Path) -> dict[str, GraspSummary]:
    """The grasps of a dataset by id as recorded; none if it cannot be read."""
    from foretouch.dataset.recording.reader import RecordedDataset

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


def suggest(grasps: Mapping[str, Mapping[str, int]], current: str, visited: int, *, tared: bool) -> list[str]:
    """What is worth doing next, a line each, the most urgent first.

    Args:
        grasps: As of `count_outcomes`.
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
    used = {name: sum(counts.values()) - counts.get(DROPPED, 0) for name, counts in grasps.items() if name != current}
    if few := sorted((count, name) for name, count in used.items() if count < VISIT_GRASPS):
        steps.append(f"few grasps: {', '.join(f'{name} {count}' for count, name in few[:4])}")
    return steps
