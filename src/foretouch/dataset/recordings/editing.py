# SPDX-License-Identifier: Apache-2.0
"""Relabel, drop and merge samples of a recorded dataset, and undo it: in a log, never in the recordings.

Each function writes one line of the log (see `foretouch.dataset.recordings.edits`) and refuses while a recorder is
writing. Samples are named by their current ids.
"""

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from foretouch.base.files import lock
from foretouch.dataset.identity import check_name, renamed_id
from foretouch.dataset.recordings.edits import Edit, append_edit, read_edits
from foretouch.dataset.recordings.folder import is_dataset
from foretouch.dataset.recordings.reader import RecordedDataset
from foretouch.errors import DatasetError, FileError


def relabel(path: str | Path, ids: Sequence[str], label: str) -> int:
    """Assign samples to another object, which also changes their ids, and return the number of the edit.

    Args:
        path: The dataset.
        ids: Of the samples.
        label: Name of the object.

    Raises:
        DatasetError: If the label is not a plain name, a sample does not exist, or two would have the same id.
        FileError: If the dataset is damaged, or a recorder is writing it.
    """
    check_name(label, "object")
    with _locked(Path(path)) as now:
        return _relabel(Path(path), now, ids, label)


def merge(path: str | Path, label: str, into: str) -> int:
    """Assign all samples of one object to another, and return the number of the edit.

    Args:
        path: The dataset.
        label: Name of the object.
        into: Name of the other.

    Raises:
        DatasetError: If there is no such sample, the name is not plain, or two samples would have the same id.
        FileError: If the dataset is damaged, or a recorder is writing it.
    """
    check_name(into, "object")
    with _locked(Path(path)) as now:
        ids = [name for name in now if name.partition("/")[0] == label]
        if not ids:
            raise DatasetError(f"{path}: holds no sample of {label!r}")
        return _relabel(Path(path), now, ids, into)


def drop(path: str | Path, ids: Sequence[str]) -> int:
    """Discard samples, which stay in the recording and are left out by builds and exports; return the number of the edit.

    Args:
        path: The dataset.
        ids: Of the samples.

    Raises:
        DatasetError: If a sample does not exist.
        FileError: If the dataset is damaged, or a recorder is writing it.
    """
    with _locked(Path(path)) as now:
        return append_edit(Path(path), Edit(action="drop", ids=_recorded(now, ids)))


def undo(path: str | Path) -> int:
    """Undo the latest edit that is in force, and return its number; a `DatasetError` if no edit is in force."""
    with _locked(Path(path)):
        in_force = read_edits(Path(path)).in_force()
        undone = max((number for number, edit in in_force.items() if edit.ids), default=0)
        if not undone:
            raise DatasetError(f"{path}: holds no edit to undo")
        append_edit(Path(path), Edit(action="undo", edit=undone))
    return undone


@contextmanager
def _locked(path: Path) -> Iterator[dict[str, str]]:
    """Return the recorded ids by the current ones of a dataset that nobody else writes meanwhile."""
    if not is_dataset(path):
        raise FileError(path, "is not a recorded dataset" if path.exists() else "does not exist")
    with lock(path):
        dataset = RecordedDataset(path)
        yield {dataset[k].id: dataset.as_recorded(k).id for k in range(len(dataset))}


def _recorded(now: dict[str, str], ids: Iterable[str]) -> tuple[str, ...]:
    absent = [name for name in ids if name not in now]
    if absent:
        raise DatasetError(f"there is no sample {', '.join(absent)}")
    return tuple(now[name] for name in ids)


def _relabel(path: Path, now: dict[str, str], ids: Sequence[str], label: str) -> int:
    recorded = _recorded(now, ids)
    taken = now.keys() - set(ids)
    for name in ids:
        wanted = renamed_id(name, label)
        if wanted in taken:
            raise DatasetError(f"{name}: id {wanted} is taken")
        taken.add(wanted)
    return append_edit(path, Edit(action="relabel", ids=recorded, object=label))
