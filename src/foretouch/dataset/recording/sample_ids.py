# SPDX-License-Identifier: Apache-2.0
"""The ids of a recorded dataset: each is used once, and numbers continue those of the session before."""

import struct
from dataclasses import replace
from itertools import chain
from pathlib import Path

from foretouch.dataset.record import SampleRecord, check_name, id_number, numbered_id
from foretouch.dataset.recording.folder import session_files
from foretouch.dataset.recording.reader import sample_messages
from foretouch.dataset.recording.records import Damage, RecordedMessage, mapped, walk
from foretouch.dataset.recording.repair import is_readable, salvaged
from foretouch.errors import DatasetError, FileError


class SampleIds:
    """The ids of a dataset; a `FileError` if one of its recordings is damaged. Not thread-safe."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._taken = {sample_id for file in session_files(path) for sample_id in _sample_ids(file)}
        self._last = max(map(id_number, self._taken), default=0)

    def with_id(self, record: SampleRecord) -> SampleRecord:
        """The record with its id; an empty one becomes `<object>/<number>`, one above the highest.

        Raises:
            DatasetError: If the object is no plain name, or the id is taken.
        """
        sample = record.sample
        check_name(sample.object, "object")
        if not sample.id:
            sample = replace(sample, id=numbered_id(sample.object, self._last + 1))
        if sample.id in self._taken:
            raise DatasetError(
                f"{self._path}: id {sample.id} is taken; `foretouch dataset build` joins datasets with equal ids"
            )
        return replace(record, sample=sample)

    def add(self, sample_id: str) -> None:
        """Mark an id as used."""
        self._taken.add(sample_id)
        self._last = max(self._last, id_number(sample_id))


def _sample_ids(path: Path) -> list[str]:
    """The ids in a file, including those after damage that `repair` would save (raises as `sample_messages`)."""
    data = mapped(path)
    cut = next((one.offset for one in walk(data) if isinstance(one, Damage)), len(data))
    saved = (one for one in salvaged(data, cut) if not isinstance(one, Damage) and is_readable(data, one))
    return [_id_of(path, data, message) for message in chain(sample_messages(path, data), saved)]


def _id_of(path: Path, data: memoryview, sample: RecordedMessage) -> str:
    """The id in a serialised sample, which follows the header (stamp, frame) and the schema version."""
    try:
        start = sample.start + 4  # CDR aligns from the end of the encapsulation header
        (frame,) = struct.unpack_from("<I", data, start + 8)
        offset = 12 + frame
        offset += -offset % 2 + 2  # the schema version
        offset += -offset % 4
        (length,) = struct.unpack_from("<I", data, start + offset)
        begin = start + offset + 4
        if begin + length > sample.end:
            raise ValueError("an id longer than its message")
        return bytes(data[begin : begin + length]).rstrip(b"\0").decode()
    except (struct.error, ValueError) as err:
        rule = f"damaged: the id of a sample cannot be read: {err}"
        raise FileError(path, rule, field=f"byte {sample.start}") from err
