# SPDX-License-Identifier: Apache-2.0
"""The operator's changes, in a log beside the recordings, which themselves are never rewritten.

The recorder writes it too, at keys and services during a session: then it is also the session's journal.

`edits.jsonl` in the dataset's folder is only appended to: one JSON object a line, each with its format version and the
SHA-256 over itself and all lines before it. Every reader applies the edits; undoing an edit appends one more line. A
last line that was cut off was never acknowledged, and is ignored.
"""

import errno
import hashlib
import json
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple, cast, get_args

from foretouch.base.files import COUNT, TEXT_LIMIT, open_own, parse_json, read_bytes, require_schema, system_errors
from foretouch.dataset.files import require_version, sync_folder
from foretouch.dataset.identity import check_name, renamed_id
from foretouch.dataset.recordings import folder
from foretouch.dataset.recordings.folder import restate, stated
from foretouch.errors import DatasetError, FileError
from foretouch.types import DISCARDED, OUTCOMES, Outcome, Sample

EDITS: Final = "edits.jsonl"
_COMPLETE_LINE: Final = re.compile(rb'"sha256": "[0-9a-f]{64}"}.')  # a crash cannot leave this much of a line
_Action = Literal["relabel", "drop", "undo", "outcome", "note", "object", "pause"]
_VERSION: Final = 2  # 1, of foretouch 0.2, has no text and no stamp
_SCHEMA: Final = {"action": str, "ids": [str], "object": str, "edit": COUNT, "text?": str, "stamp_ns?": COUNT}


@dataclass(frozen=True, kw_only=True)
class Edit:
    """One change of samples: their object or outcome, a note, that they are discarded; or the undoing of another edit.

    `object` and `pause` change no sample: from then on another object is on the table, or nothing is recorded. A note
    without samples is one on the session.
    """

    action: _Action
    ids: tuple[str, ...] = ()  # of the samples, as they were recorded
    object: str = (
        ""  # for `relabel` and `object`, the new one; for `undo` of `object`, the one before, of the samples since
    )
    edit: int = 0  # for `undo`, the number of the reverted edit; the first is 1
    text: str = ""  # for `outcome` and `note`
    stamp_ns: int = 0  # when it was made during a session [ns]; 0 for later ones


class Changes(NamedTuple):
    """What the edits make of one sample."""

    object: str | None = None  # None: as recorded, as all below
    outcome: Outcome | None = None
    notes: tuple[str, ...] = ()
    dropped: bool = False


class EditLog:
    """The edits of a dataset, in order, and their effect on its samples."""

    def __init__(self, edits: Sequence[Edit] = ()) -> None:
        self.edits = tuple(edits)
        self._undone = {edit.edit for edit in edits if edit.action == "undo"}
        self._changes: dict[str, Changes] = {}
        for number, edit in enumerate(self.edits, 1):
            for recorded in () if number in self._undone else edit.ids:
                self._changes[recorded] = _changed(self.changes(recorded), edit)

    def in_force(self) -> dict[int, Edit]:
        """Return the edits that were not undone, by number."""
        return {n: edit for n, edit in enumerate(self.edits, 1) if edit.action != "undo" and n not in self._undone}

    def changes(self, recorded: str) -> Changes:
        """Return what the edits make of a sample, by its id as it was recorded."""
        return self._changes.get(recorded, Changes())

    def apply(self, sample: Sample) -> Sample:
        """Apply the edits to a record; a new object also changes the id."""
        recorded = sample.id
        label, outcome, notes, dropped = self.changes(recorded)
        if label is not None:
            renamed = renamed_id(recorded, label)
            sample = replace(sample, id=renamed, object=label)
        if dropped and DISCARDED not in sample.flags:
            sample = replace(sample, flags=(*sample.flags, DISCARDED))
        note = "; ".join(filter(None, (sample.note, *notes)))
        return replace(sample, outcome=outcome or sample.outcome, note=note) if outcome or notes else sample

    def descriptions(self) -> list[str]:
        """Return each edit in words, with its number."""
        lines = []
        for number, edit in enumerate(self.edits, 1):
            samples = f"({len(edit.ids)} samples)" if edit.ids else ""
            words = [edit.action, edit.object, edit.text, samples]
            text = f"undo {edit.edit}" if edit.action == "undo" else " ".join(filter(None, words))
            lines.append(f"{number}: {text}{' (undone)' if number in self._undone else ''}")
        return lines


def _changed(changes: Changes, edit: Edit) -> Changes:
    if edit.action == "drop":
        return changes._replace(dropped=True)
    if edit.action == "note":
        return changes._replace(notes=(*changes.notes, edit.text))
    if edit.action == "outcome":
        return changes._replace(outcome=cast("Outcome", edit.text))
    return changes._replace(object=edit.object)


def read_edits(path: Path) -> EditLog:
    """Read the log of a dataset.

    Raises a `FileError` that names the line that is damaged or of another version, and if the log is not the one that the
    manifest states, or a part of it.
    """
    return EditLog(_read(path)[0])


def append_edit(path: Path, edit: Edit) -> int:
    """Append an edit, which is on the disk when this returns, and return its number; the caller holds the lock.

    After a `FileError`, as of a full disk, it is not in force.
    """
    file = path / EDITS
    edits, before, size = _read(path)
    body = {"schema_version": _VERSION, **asdict(edit)}
    digest = _digest(before, body)
    line = (json.dumps({**body, "sha256": digest}, ensure_ascii=False) + "\n").encode()
    with system_errors(file):
        with os.fdopen(open_own(file, os.O_WRONLY | os.O_APPEND), "ab", buffering=0) as log:
            log.truncate(size)  # remove a line that a crash cut off
            try:
                if log.write(line) < len(line):
                    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
                os.fsync(log.fileno())
                restate(path, folder.EDITS, {"count": len(edits) + 1, "sha256": digest})
            except (OSError, FileError):
                log.truncate(size)
                raise
        sync_folder(path)
    return len(edits) + 1


def _read(path: Path) -> tuple[list[Edit], str, int]:
    """Return the edits of a dataset, the digest of all, and the offset of the next one [bytes]."""
    file, manifest = path / EDITS, stated(path, folder.EDITS)
    data = read_bytes(file, TEXT_LIMIT) if os.path.lexists(file) else b""
    edits: list[Edit] = []
    reached = not manifest  # whether the log holds what the manifest states
    digest, size = "", data.rfind(b"\n") + 1
    if _COMPLETE_LINE.search(data, size):
        raise FileError(file, "damaged: the last line is complete, but has no line end", field=f"byte {size}")
    for number, line in enumerate(data[:size].split(b"\n")[:-1], 1):
        try:
            edit, digest = _edit(line, digest, len(edits))
        except (DatasetError, FileError, ValueError) as err:
            rule = err.rule if isinstance(err, FileError) else " ".join(str(err).split())
            raise FileError(file, rule, field=f"line {number}") from err
        edits.append(edit)
        reached |= manifest == {"count": len(edits), "sha256": digest}
    if not reached:
        cure = "restore it, or go on without edits by `foretouch dataset repair`"
        raise FileError(
            file, f"holds {len(edits)} edits, not the {manifest.get('count')} that the manifest states: {cure}"
        )
    return edits, digest, size


def _edit(line: bytes, before: str, known: int) -> tuple[Edit, str]:
    """Return the edit in a line after a number of known ones, and the digest up to it."""
    content = require_schema("", parse_json(line), dict)
    require_version(content.get("schema_version"), _VERSION, 1)
    digest = _digest(before, {name: value for name, value in content.items() if name != "sha256"})
    if content.get("sha256") != digest:
        raise DatasetError("damaged: this line and those before it do not match their checksum")
    require_schema("", content, _SCHEMA)
    names = {name.removesuffix("?") for name in _SCHEMA} & content.keys()
    edit = Edit(**{name: content[name] for name in names} | {"ids": tuple(content["ids"])})
    if edit.action not in get_args(_Action):
        raise DatasetError(f"action {edit.action!r} is not one of {', '.join(get_args(_Action))}")
    if edit.action in ("relabel", "object") or (edit.action == "undo" and edit.ids):
        check_name(edit.object, "object")
    if edit.action == "outcome" and edit.text not in OUTCOMES:
        raise DatasetError(f"text: {edit.text!r} is not one of {', '.join(OUTCOMES)}")
    if edit.action == "undo" and not 0 < edit.edit <= known:
        raise DatasetError(f"edit {edit.edit} is not one of the {known} before")
    return edit, digest


def _digest(before: str, body: Mapping[str, Any]) -> str:
    return hashlib.sha256((before + json.dumps(body, sort_keys=True)).encode()).hexdigest()
