# SPDX-License-Identifier: Apache-2.0
"""What an operator changed afterwards: a log beside the recordings, which themselves are never rewritten.

`edits.jsonl` in the dataset's folder is only ever appended to, one JSON object a line, each with the SHA-256 of itself
and all before it. Whoever reads the dataset sees the samples as edited; an edit is taken back by one more line. A last
line that was cut off was never acknowledged, and does not count.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, Literal

from foretouch.dataset.recording.folder import sync_folder
from foretouch.dataset.recording.record import DISCARDED, SampleRecord, check_name
from foretouch.errors import DatasetError, FileError

__all__ = ["Edit", "EditLog", "append_edit", "read_edits"]

EDITS: Final = "edits.jsonl"
_BEYOND: Final = re.compile(rb'"sha256": "[0-9a-f]{64}"}.')  # more than a crash can leave of a line
_ACTIONS: Final = ("relabel", "drop", "undo")


@dataclass(frozen=True, kw_only=True)
class Edit:
    """One change.

    Attributes:
        action: `relabel` gives samples another object, `drop` discards them, `undo` takes an edit back.
        ids: Of the samples, as they were recorded.
        object: For `relabel`.
        edit: For `undo`, the number of the edit that is taken back; the first is 1.
    """

    action: Literal["relabel", "drop", "undo"]
    ids: tuple[str, ...] = ()
    object: str = ""
    edit: int = 0

    def told(self) -> str:
        """In words."""
        if self.action == "undo":
            return f"undo {self.edit}"
        return " ".join(filter(None, [self.action, self.object, f"({len(self.ids)} samples)"]))


class EditLog:
    """The edits of a dataset, and what they make of its samples.

    Args:
        edits: In their order.

    Attributes:
        edits: Likewise.
        undone: Numbers of those that were taken back.
    """

    def __init__(self, edits: Sequence[Edit] = ()) -> None:
        self.edits = tuple(edits)
        self.undone = {edit.edit for edit in edits if edit.action == "undo"}
        self._labels: dict[str, str] = {}
        self._dropped: set[str] = set()
        for edit in self.in_force().values():
            if edit.action == "relabel":
                self._labels |= dict.fromkeys(edit.ids, edit.object)
            else:
                self._dropped.update(edit.ids)

    def in_force(self) -> dict[int, Edit]:
        """Those that hold, by number."""
        numbered = enumerate(self.edits, 1)
        return {number: edit for number, edit in numbered if edit.action != "undo" and number not in self.undone}

    def apply(self, record: SampleRecord) -> SampleRecord:
        """The record as edited; its id follows its object."""
        recorded = record.sample.id
        label = self._labels.get(recorded)
        if label is not None:
            sample = replace(record.sample, id=f"{label}/{recorded.partition('/')[2]}", object=label)
            record = replace(record, sample=sample)
        if recorded in self._dropped and DISCARDED not in record.flags:
            record = replace(record, flags=(*record.flags, DISCARDED))
        return record

    def told(self) -> list[str]:
        """Each in words, with its number."""
        return [
            f"{number}: {edit.told()}{' (undone)' if number in self.undone else ''}"
            for number, edit in enumerate(self.edits, 1)
        ]


def read_edits(path: Path) -> EditLog:
    """The edits of a dataset.

    Raises:
        FileError: If the log is damaged or of a newer version; names the line.
    """
    return EditLog(_read(path / EDITS)[0])


def append_edit(path: Path, edit: Edit) -> int:
    """Add an edit; it is on the disk when this returns. The caller holds the dataset's lock.

    Returns:
        Its number.

    Raises:
        FileError: If the log is damaged or cannot be written.
    """
    file = path / EDITS
    edits, digest, size = _read(file)
    body = {"action": edit.action, "ids": list(edit.ids), "object": edit.object, "edit": edit.edit}
    line = json.dumps({**body, "sha256": _digest(digest, body)}, ensure_ascii=False) + "\n"
    try:
        with file.open("ab") as log:
            log.truncate(size)  # what a crash left of a line
            log.write(line.encode())
            log.flush()
            os.fsync(log.fileno())
        sync_folder(path)
    except OSError as err:
        raise FileError(file, f"{err.strerror or err} (errno {err.errno})") from err
    return len(edits) + 1


def _read(file: Path) -> tuple[list[Edit], str, int]:
    """The edits, the digest of the last, and where the next one goes."""
    try:
        data = file.read_bytes()
    except FileNotFoundError:
        return [], "", 0
    except OSError as err:
        raise FileError(file, err.strerror or str(err)) from err
    edits: list[Edit] = []
    digest = ""
    size = data.rfind(b"\n") + 1
    if _BEYOND.search(data, size):
        raise FileError(file, "damaged: the last line is whole, and does not end", field=f"byte {size}")
    for number, line in enumerate(data[:size].split(b"\n")[:-1], 1):
        try:
            edit, digest = _edit(line, digest, len(edits))
        except (DatasetError, ValueError, KeyError, TypeError, RecursionError) as err:
            raise FileError(file, " ".join(str(err).split()), field=f"line {number}") from err
        edits.append(edit)
    return edits, digest, size


def _edit(line: bytes, before: str, known: int) -> tuple[Edit, str]:
    """The edit in a line, and the digest up to it."""
    content: Any = json.loads(line)
    if not isinstance(content, dict) or content.pop("sha256", None) != _digest(before, content):
        raise DatasetError("damaged: this and the lines before are not those of which the checksum was taken")
    if content["action"] not in _ACTIONS:
        raise DatasetError(f"action {content['action']!r} is none of {', '.join(_ACTIONS)}: a newer foretouch wrote it")
    edit = Edit(action=content["action"], ids=tuple(content["ids"]), object=content["object"], edit=content["edit"])
    if edit.action == "relabel":
        check_name(edit.object, "object")
    if edit.action == "undo" and not 0 < edit.edit <= known:
        raise DatasetError(f"edit {edit.edit} is none of the {known} before")
    return edit, _digest(before, content)


def _digest(before: str, body: Mapping[str, Any]) -> str:
    return hashlib.sha256((before + json.dumps(body, sort_keys=True)).encode()).hexdigest()
