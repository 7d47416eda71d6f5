# SPDX-License-Identifier: Apache-2.0
"""Relabel, drop and merge samples of a recorded dataset, and take it back: by a log, never in the recordings.

Each function writes one line of the log (see `foretouch.dataset.recording.edits`) and refuses while a recorder writes.
Samples are named by the ids that they have now.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

from foretouch.dataset.recording import RecordedDataset, is_dataset
from foretouch.dataset.recording.edits import Edit, append_edit, read_edits
from foretouch.dataset.recording.folder import lock
from foretouch.dataset.recording.record import check_name
from foretouch.errors import DatasetError, FileError

__all__ = ["drop", "merge", "relabel", "undo"]


def relabel(path: str | Path, ids: Sequence[str], label: str) -> int:
    """Give samples another object; their ids follow it.

    Args:
        path: Of the dataset.
        ids: Of the samples.
        label: Of the object.

    Returns:
        The number of the edit.

    Raises:
        DatasetError: If the label is no plain name, a sample is not there, or two would have one id.
        FileError: If the dataset is damaged, or a recorder writes it.
    """
    check_name(label, "object")
    return _edit(Path(path), lambda now: Edit(action="relabel", ids=_renamed(now, ids, label), object=label))


def merge(path: str | Path, label: str, into: str) -> int:
    """Make one object of two: all samples of `label` become samples of `into` (raises as `relabel`)."""
    check_name(into, "object")

    def make(now: dict[str, str]) -> Edit:
        ids = [name for name in now if name.partition("/")[0] == label]
        if not ids:
            raise DatasetError(f"{path}: holds no sample of {label!r}")
        return Edit(action="relabel", ids=_renamed(now, ids, into), object=into)

    return _edit(Path(path), make)


def drop(path: str | Path, ids: Sequence[str]) -> int:
    """Discard samples: they stay in the recording and go no further (raises as `relabel`)."""
    return _edit(Path(path), lambda now: Edit(action="drop", ids=_recorded(now, ids)))


def undo(path: str | Path) -> int:
    """Take back the latest edit that holds.

    Returns:
        The number of the edit that was taken back.

    Raises:
        DatasetError: If none holds.
        FileError: As `relabel`.
    """
    taken = 0

    def make(_: dict[str, str]) -> Edit:
        nonlocal taken
        taken = max(read_edits(Path(path)).in_force(), default=0)
        if not taken:
            raise DatasetError(f"{path}: holds no edit to undo")
        return Edit(action="undo", edit=taken)

    _edit(Path(path), make)
    return taken


def _edit(path: Path, make: Callable[[dict[str, str]], Edit]) -> int:
    """Append the edit that is made of the ids, those of now to those of the recording."""
    if not is_dataset(path):
        raise FileError(path, "is no recorded dataset" if path.exists() else "does not exist")
    with lock(path):
        with RecordedDataset(path) as dataset:
            now = {dataset[k].record.sample.id: dataset.recorded_id(k) for k in range(len(dataset))}
        return append_edit(path, make(now))


def _recorded(now: dict[str, str], ids: Iterable[str]) -> tuple[str, ...]:
    absent = [name for name in ids if name not in now]
    if absent:
        raise DatasetError(f"there is no sample {', '.join(absent)}")
    return tuple(now[name] for name in ids)


def _renamed(now: dict[str, str], ids: Sequence[str], label: str) -> tuple[str, ...]:
    recorded = _recorded(now, ids)
    taken = now.keys() - set(ids)
    for name in ids:
        wanted = f"{label}/{name.partition('/')[2]}"
        if wanted in taken:
            raise DatasetError(f"{name}: id {wanted} is taken")
        taken.add(wanted)
    return recorded
