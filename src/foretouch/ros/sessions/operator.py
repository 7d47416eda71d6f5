# SPDX-License-Identifier: Apache-2.0
"""What the operator does during a session, by key or service: each action is an edit in the dataset's log.

An action on the last grasp while one is being executed waits for that grasp, so that it is not taken for the one before.
Beside it, the grasps of the session so far.
"""

import sys
import time
from collections import Counter, deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import count
from typing import Final, Literal, NamedTuple

from foretouch.dataset.identity import check_name, renamed_id
from foretouch.dataset.labelling.assembler import SampleAssembler
from foretouch.dataset.recordings.edits import Edit, EditLog, read_edits
from foretouch.dataset.recordings.writer import RecordingWriter
from foretouch.errors import DatasetError, ForetouchError
from foretouch.types import DISCARDED, Sample

Action = Literal["object", "success", "failure", "unknown", "drop", "relabel", "note", "pause", "undo"]
_DROPPED: Final = "dropped"  # instead of an outcome


class GraspSummary(NamedTuple):
    """What is kept of a sample."""

    object: str
    outcome: str  # or `_DROPPED`
    touched: bool


class Reply(NamedTuple):
    """What became of an action."""

    text: str
    done: bool
    at_s: float  # by `time.monotonic`


@dataclass(frozen=True)
class OperatorState:
    """What a session shows its operator."""

    object: str = ""  # on the table
    paused: bool = False  # whether nothing is recorded
    grasps: Mapping[str, Mapping[str, int]] | None = None  # of the session, by object and outcome
    replies: Sequence[Reply] = ()  # to the latest actions, also to those that waited for a grasp


class Operator:
    """The operator's actions in a session. Not thread-safe.

    Args:
        writer: Of the session.
        assembler: Of the session; its `objects` follow the actions.
        plan: Objects that are to be recorded, in order.
        clock_ns: Gives the time of the stamps [ns].
    """

    def __init__(
        self, writer: RecordingWriter, assembler: SampleAssembler, plan: Sequence[str], clock_ns: Callable[[], int]
    ) -> None:
        self._writer = writer
        self._assembler = assembler
        self._plan = plan
        self._clock_ns = clock_ns
        self._log: EditLog = read_edits(writer.path)
        self._first = len(self._log.edits)
        self._grasps: dict[str, GraspSummary] = {}  # by id as recorded
        self._touched: list[str] = []  # ids as recorded of the samples with a touch
        self._sample_of: dict[
            str, str
        ] = {}  # by id of the grasp: id as recorded, or after a colon why none was recorded
        self._waiting: list[tuple[Action, str]] = []
        self._visits = [0]  # of each object: samples before it was laid on the table
        self._replies: deque[Reply] = deque(maxlen=8)
        self._state, self._known = OperatorState(), (-1, -1)

    @property
    def paused(self) -> int:
        """Number of the pause that is in force; 0 without one."""
        own = self._own_edits()
        return next((number for number, edit in own.items() if edit.action == "pause"), 0)

    def state(self) -> OperatorState:
        """Return the state; grasps are counted anew after each change."""
        known = (len(self._log.edits), len(self._grasps))
        if known != self._known:
            grasps = edited(self._grasps, self._log)
            self._known = known
            self._state = OperatorState(self._object, bool(self.paused), _count_outcomes(grasps.values(), self._plan))
        return replace(self._state, replies=tuple(self._replies))

    def act(self, action: Action, text: str = "", grasp_id: str = "") -> str:
        """Do one action, which is then on the disk or waits for a grasp, and return what was done in a few words.

        Args:
            action: `undo` reverts the latest one that is in force; `pause` during a pause ends it.
            text: Name of the object for `object` (by default the next of the plan) and `relabel` (the one on the table);
                the remark for `note`; `on` or `off` for `pause`, which by default changes between them.
            grasp_id: Of the grasp, of this session; "" for the latest.

        Raises:
            DatasetError: If it cannot be done: a dropped or unknown grasp, no plain name, nothing to undo.
            FileError: If it cannot be written; it is then not done.
        """
        try:
            done = self._do(action, text, grasp_id)
        except ForetouchError as err:
            self._reply(f"not done: {err}", done=False)
            raise
        self._reply(done)
        return done

    def add_sample(self, sample: Sample, recorded: str) -> None:
        """Note that a sample was written under an id, and do what waits for it."""
        self._grasps[recorded] = summarise(sample)
        if sample.touch is not None:
            self._touched.append(recorded)
            self._sample_of[sample.grasp.id] = recorded
            self.end_wait()

    def add_rejected(self, grasp_id: str, message: str) -> None:
        """Note that an executed grasp makes no sample."""
        self._sample_of.setdefault(grasp_id, f": no sample: {message}")
        self.end_wait(message)

    def end_wait(self, reason: str = "") -> None:
        """Do what waits for a grasp, which is the last sample; with a reason, there is no such grasp."""
        waiting, self._waiting = self._waiting, []
        for action, text in waiting:
            try:
                if reason:
                    raise DatasetError(reason)
                self._reply(self._edit(action, text, self._touched[-1]))
            except ForetouchError as err:
                self._reply(f"not done: {_words(action, text)}: {err}", done=False)

    @property
    def _object(self) -> str:
        return self._assembler.objects[-1][1] or "unknown"

    def _own_edits(self) -> dict[int, Edit]:
        return {number: edit for number, edit in self._log.in_force().items() if number > self._first}

    def _do(self, action: Action, text: str, grasp_id: str) -> str:
        if action == "undo":
            return self._undo()
        if action == "object":
            return self._next_object(text)
        if action == "pause":
            paused = self.paused
            if text and (text == "on") == bool(paused):
                return "paused already" if paused else "is being recorded already"
            self._write(Edit(action="undo", edit=paused) if paused else Edit(action="pause"))
            return "recording goes on" if paused else "paused: nothing is recorded"
        if action == "relabel":
            text = check_name(text or self._object, "object")
        if not grasp_id and self._assembler.expects_grasp(time.monotonic()):
            self._waiting.append((action, text))
            return f"{_words(action, text)}: waits for the grasp that is being recorded"
        recorded = self._touched[-1] if self._touched else ""
        if grasp_id:
            recorded = self._sample_of.get(grasp_id, ": is not one of the recorded grasps of this session")
        if recorded.startswith(":"):
            raise DatasetError(f"grasp {grasp_id}{recorded}")
        if not recorded and action != "note":
            raise DatasetError("no grasp was recorded in this session yet")
        return self._edit(action, text, recorded)

    def _edit(self, action: Action, text: str, recorded: str) -> str:
        """Edit a sample; a note may also be on the session, ""."""
        changes, ids = self._log.changes(recorded), tuple(filter(None, [recorded]))
        name = renamed_id(recorded, changes.object) if changes.object else recorded
        if changes.dropped:
            raise DatasetError(f"{name}: is dropped; undo that first")
        if action == "relabel":
            edit = Edit(action="relabel", ids=ids, object=text)
        elif action == "note":
            edit = Edit(action="note", ids=ids, text=text or "marked")
        else:
            edit = Edit(action="drop", ids=ids) if action == "drop" else Edit(action="outcome", ids=ids, text=action)
        self._write(edit)
        return f"{name or 'session'}: {_words(action, text)}"

    def _next_object(self, name: str) -> str:
        before, plan = self._object, self._plan
        following = plan[plan.index(before) + 1 :] if before in plan else plan
        known = {before, *self._writer.objects}
        numbered = (f"object-{number}" for number in count(1))
        free = next(candidate for candidate in numbered if candidate not in known)
        name = check_name(name or next(iter(following), free), "object")
        if name == before:
            raise DatasetError(f"{name} is on the table already")
        self._write(Edit(action="object", object=name))
        self._assembler.objects.append((self._clock_ns(), name))
        self._visits.append(len(self._touched))
        return f"on the table: {name}"

    def _undo(self) -> str:
        if self._waiting:
            return f"undone: {_words(*self._waiting.pop())}"
        if not (own := self._own_edits()):
            raise DatasetError("nothing to undo in this session")
        number, edit = max(own.items())
        if edit.action != "object":
            self._write(Edit(action="undo", edit=number))
            return f"{''.join(f'{name}: ' for name in edit.ids)}undone: {_words(edit.action, edit.object or edit.text)}"
        # The object before is on the table, and was for all grasps since.
        before, first = self._assembler.objects[-2][1] or "unknown", self._visits[-1]
        since = tuple(grasp for grasp in self._touched[first:] if self._grasps[grasp].object == edit.object)
        self._write(Edit(action="undo", edit=number, ids=since, object=before if since else ""))
        self._assembler.objects.pop()
        self._visits.pop()
        also = f", also in the {len(since)} grasps since" if since else ""
        return f"on the table: {before}{also}"

    def _write(self, edit: Edit) -> None:
        edit = replace(edit, stamp_ns=self._clock_ns())
        self._writer.edit(edit)
        self._log = EditLog((*self._log.edits, edit))

    def _reply(self, text: str, *, done: bool = True) -> None:
        self._replies.append(Reply(text, done, time.monotonic()))


def _words(action: str, text: str) -> str:
    names = {"relabel": f"is {text}", "note": f"note {text}".rstrip(), "drop": "dropped", "outcome": text}
    return names.get(action, action)


def summarise(sample: Sample) -> GraspSummary:
    """Summarise a sample as it was recorded."""
    outcome = _DROPPED if DISCARDED in sample.flags else sample.outcome
    return GraspSummary(sys.intern(sample.object), outcome, sample.touch is not None)


def edited(grasps: Mapping[str, GraspSummary], edits: EditLog) -> dict[str, GraspSummary]:
    """Return the grasps with the edits applied; the keys stay the ids as recorded."""
    result = {}
    for recorded, grasp in grasps.items():
        label, outcome, _, dropped = edits.changes(recorded)
        changed = (label or grasp.object, _DROPPED if dropped else outcome or grasp.outcome)
        result[recorded] = grasp if changed == grasp[:2] else grasp._replace(object=changed[0], outcome=changed[1])
    return result


def _count_outcomes(grasps: Iterable[GraspSummary], plan: Sequence[str] = ()) -> dict[str, Counter[str]]:
    """Return executed grasps by object and outcome; objects of the plan first."""
    counts: dict[str, Counter[str]] = {name: Counter() for name in plan}
    for grasp in grasps:
        if grasp.touched:
            counts.setdefault(grasp.object, Counter())[grasp.outcome] += 1
    return counts
