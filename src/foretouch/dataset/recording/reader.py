# SPDX-License-Identifier: Apache-2.0
"""Reads the samples of a recorded dataset, in the order of their recording."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import NamedTuple, Self

from mcap.records import Metadata

from foretouch.dataset.recording.accounts import Accounts
from foretouch.dataset.recording.edits import EditLog, read_edits
from foretouch.dataset.recording.folder import is_dataset, read_identity, session_files
from foretouch.dataset.recording.mcap_file import MAGIC
from foretouch.dataset.recording.messages import ACCOUNTS, SAMPLE_TYPE, StoredSample, decode_sample
from foretouch.dataset.recording.offset_index import Place, sample_places
from foretouch.dataset.recording.scan import RawRecord, declaration, mapped, records
from foretouch.errors import DatasetError, FileError

__all__ = ["RecordedDataset", "holds_samples", "is_finished"]


class _Sample(NamedTuple):
    file: Path
    data: memoryview
    place: Place


class RecordedDataset:
    """The samples of a dataset, or of one of its files; a context manager.

    Args:
        path: Of the dataset, or of a `.mcap` file.

    Attributes:
        path: As given.
        files: The recordings in it.
        unfinished: Those that were cut off; what they hold up to there is read.
        edits: What was changed afterwards; samples are given as edited. A single file has none.

    Raises:
        FileError: If there is no such thing, or a manifest or recording is damaged; names file and place.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        if is_dataset(self.path):
            read_identity(self.path)
            self.files = session_files(self.path)
            self.edits = read_edits(self.path)
        elif self.path.is_file():
            self.files = [self.path]
            self.edits = EditLog()
        else:
            rule = "is no recorded dataset" if self.path.exists() else "does not exist"
            raise FileError(self.path, rule)
        self._closed = False
        self._samples: list[_Sample] = []
        with ExitStack() as stack:
            for file in self.files:
                data = stack.enter_context(mapped(file))
                self._samples += [_Sample(file, data, place) for place in sample_places(file, data)]
            self._open = stack.pop_all()
        self.unfinished = [file for file in self.files if not is_finished(file)]

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Let go of the files; more than once does no harm."""
        self._closed = True
        self._samples = []
        self._open.close()

    def __len__(self) -> int:
        return len(self._samples)

    def __getitem__(self, index: int) -> StoredSample:
        """One sample as edited, its bytes proven by their SHA-256.

        Raises:
            FileError: If it is damaged or of another schema version; names file and place.
        """
        stored = self._stored(index)
        return replace(stored, record=self.edits.apply(stored.record)) if self.edits.edits else stored

    def __iter__(self) -> Iterator[StoredSample]:
        for k in range(len(self)):
            yield self[k]

    def _stored(self, index: int) -> StoredSample:
        if self._closed:
            raise FileError(self.path, "is closed")
        sample = self._samples[index]
        start, end, _ = sample.place
        try:
            return decode_sample(bytes(sample.data[start:end]))
        except DatasetError as err:
            raise FileError(sample.file, str(err), field=f"sample at byte {start}") from err

    def recorded_id(self, index: int) -> str:
        """The id that a sample was recorded with (raises as indexing)."""
        return self._stored(index).record.sample.id

    def accounts(self) -> Accounts:
        """What became of every message, summed over the recordings: the last word of each.

        Raises:
            FileError: If an account is damaged.
        """
        total = Accounts()
        for file in self.files:
            with mapped(file) as data:
                total.add(_last_accounts(file, data))
        return total

    def name(self, index: int) -> str:
        """Where a sample lies, for messages."""
        sample = self._samples[index]
        return f"{sample.file}[{sample.place.start}]"


def _last_accounts(path: Path, data: memoryview) -> Accounts:
    last = Accounts()
    for record in records(data, len(MAGIC)):
        content = declaration(data, record) if isinstance(record, RawRecord) else None
        if isinstance(content, Metadata) and content.name == ACCOUNTS:
            try:
                last = Accounts.from_mapping(content.metadata)
            except DatasetError as err:
                raise FileError(path, str(err), field=f"byte {record.offset}") from err
    return last


def is_finished(path: Path) -> bool:
    """Whether a recording was closed, so that it has an index."""
    with path.open("rb") as file:
        size = file.seek(0, 2)
        if size <= 2 * len(MAGIC):
            return False
        file.seek(size - len(MAGIC))
        return file.read() == MAGIC


def holds_samples(path: Path) -> bool:
    """Whether a path is a recorded dataset, or an MCAP file that declares samples near its start."""
    if path.is_dir():
        return is_dataset(path)
    if path.suffix != ".mcap" or not path.is_file():
        return False
    with path.open("rb") as file:
        start = file.read(65536)
    return start.startswith(MAGIC) and SAMPLE_TYPE.encode() in start
