# SPDX-License-Identifier: Apache-2.0
"""Ids of the samples of a dataset: each is given once, and numbers go on where the session before ended."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from foretouch.dataset.recording.folder import session_files
from foretouch.dataset.recording.offset_index import sample_ids
from foretouch.dataset.recording.record import SampleRecord, check_name
from foretouch.errors import DatasetError

__all__ = ["SampleNames"]


class SampleNames:
    """The ids that are taken. Not thread-safe.

    Args:
        path: Of the dataset.

    Raises:
        FileError: If a recording in it is damaged.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._taken = {i for file in session_files(path) for i in sample_ids(file)}
        self._last = max(map(_number, self._taken), default=0)

    def named(self, record: SampleRecord) -> SampleRecord:
        """The record with its id; an empty one becomes `<object>/<number>`, one above the highest.

        Raises:
            DatasetError: If the object is no plain name, or the id is taken.
        """
        sample = record.sample
        check_name(sample.object, "object")
        if not sample.id:
            sample = replace(sample, id=f"{sample.object}/{self._last + 1:06d}")
        if sample.id in self._taken:
            raise DatasetError(f"{self._path}: id {sample.id} is taken")
        return replace(record, sample=sample)

    def take(self, sample_id: str) -> None:
        """The sample is in the file."""
        self._taken.add(sample_id)
        self._last = max(self._last, _number(sample_id))


def _number(sample_id: str) -> int:
    """The number in an id that a writer gave; others are no numbers of ours."""
    name = sample_id.rpartition("/")[2]
    return int(name) if 6 <= len(name) <= 9 and name.isdecimal() and name.isascii() else 0  # 10 digits: unix times
