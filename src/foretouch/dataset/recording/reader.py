# SPDX-License-Identifier: Apache-2.0
"""Reads the samples of a recorded dataset, in the order of their recording.

The offsets of the samples are found without decoding other messages: a chunk's index lists its channels, so chunks
without samples are skipped unread. A recording that was cut off is read as far as it is intact.
"""

import struct
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple, Self, TypeVar

from mcap.opcode import Opcode
from mcap.records import Channel, Metadata, Schema, Statistics

from foretouch.checked_files import open_regular
from foretouch.dataset.record import Identity
from foretouch.dataset.recording import scan
from foretouch.dataset.recording.edits import EditLog, read_edits
from foretouch.dataset.recording.folder import is_dataset, recorded_files
from foretouch.dataset.recording.mcap_file import MAGIC
from foretouch.dataset.recording.message_counts import MessageCounts
from foretouch.dataset.recording.messages import COUNTS, SAMPLE_TYPE, StoredSample, decode_sample
from foretouch.dataset.recording.recovery import samples_after_damage
from foretouch.dataset.samples import DatasetFormat, SampleSet
from foretouch.errors import DatasetError, FileError

_T = TypeVar("_T")


class SampleOffset(NamedTuple):
    """Start and end of a sample's CDR in its file [bytes], and when it was logged [ns]."""

    start: int
    end: int
    log_time_ns: int


class _Sample(NamedTuple):
    file: Path
    data: memoryview
    offset: SampleOffset


class RecordedDataset:
    """The samples of a recorded dataset, or of one of its `.mcap` files; a context manager.

    Attributes:
        path: As given.
        files: The MCAP files.
        unfinished: Files that were cut off; they are read as far as they are intact.
        edits: Later changes, which are applied to the samples. A single file has none.

    Raises:
        FileError: If the path is no recorded dataset, or a manifest or recording is damaged; names file and position.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self.files = recorded_files(self.path)
        self.edits = read_edits(self.path) if self.path.is_dir() else EditLog()
        self._closed = False
        self._samples: list[_Sample] = []
        self.unfinished: list[Path] = []
        with ExitStack() as stack:
            for file in self.files:
                data = stack.enter_context(scan.mapped(file))
                found = [_Sample(file, data, offset) for offset in sample_offsets(file, data)]
                if _is_finished(data):
                    _check_count(file, data, len(found))
                else:
                    self.unfinished.append(file)
                self._samples += found
            self._open = stack.pop_all()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the files; may be called more than once."""
        self._closed = True
        self._samples = []
        self._open.close()

    def __len__(self) -> int:
        return len(self._samples)

    def __getitem__(self, index: int) -> StoredSample:
        """One sample with the edits applied, its bytes verified by their SHA-256.

        Raises:
            FileError: If it is damaged or of another schema version; names file and position.
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
        start, end, _ = sample.offset
        try:
            return decode_sample(bytes(sample.data[start:end]))
        except DatasetError as err:
            raise FileError(sample.file, str(err), field=f"sample at byte {start}") from err

    def recorded_id(self, index: int) -> str:
        """The id of a sample before any edit (raises as indexing)."""
        return self._stored(index).record.sample.id

    def message_counts(self) -> MessageCounts:
        """The message counts, summed over the last ones of each recording.

        Raises:
            FileError: If they are damaged.
        """
        total = MessageCounts()
        for file in self.files:
            with scan.mapped(file) as data:
                total.add(_last_counts(file, data))
        return total

    def name(self, index: int) -> str:
        """File and offset of a sample, for messages."""
        sample = self._samples[index]
        return f"{sample.file}[{sample.offset.start}]"


def _last_counts(path: Path, data: memoryview) -> MessageCounts:
    last = MessageCounts()
    for record in scan.records(data, len(MAGIC)):
        content = scan.declaration(data, record) if isinstance(record, scan.RawRecord) else None
        if isinstance(content, Metadata) and content.name == COUNTS:
            try:
                last = MessageCounts.from_mapping(content.metadata)
            except DatasetError as err:
                raise FileError(path, str(err), field=f"byte {record.offset}") from err
    return last


def _is_finished(data: memoryview) -> bool:
    """Whether a recording was closed, so that it has an index."""
    return len(data) > 2 * len(MAGIC) and bytes(data[-len(MAGIC) :]) == MAGIC


def _check_count(path: Path, data: memoryview, found: int) -> None:
    """Compare the samples found in a finished file with the count in its summary.

    Schemas, channels and indexes outside of chunks have no checksum: one changed byte there hides samples.
    """
    start, end = _require(path, scan.summary_of(data))
    schemas: set[int] = set()
    counts: dict[int, int] = {}
    channels: set[int] = set()
    for item in scan.records(data, start, end):
        record = _require(path, item)
        if not isinstance(record, scan.RawRecord):
            continue
        content: object = scan.declaration(data, record)
        if record.opcode == Opcode.STATISTICS:
            content = scan.parse(Statistics, data, record)
        if isinstance(content, scan.Damage):
            raise content.error(path)
        if isinstance(content, Schema) and content.name == SAMPLE_TYPE:
            schemas.add(content.id)
        elif isinstance(content, Channel) and content.schema_id in schemas:
            channels.add(content.id)
        elif isinstance(content, Statistics):
            counts = content.channel_message_counts
    declared = sum(counts.get(channel, 0) for channel in channels)
    if declared != found:
        raise FileError(path, f"damaged: holds {found} samples, its index declares {declared}", field="samples")


def holds_samples(path: Path) -> bool:
    """Whether a path is a recorded dataset, or an MCAP file that declares samples near its start."""
    if path.is_dir():
        return is_dataset(path)
    if path.suffix != ".mcap" or not path.is_file():
        return False
    with open_regular(path) as file:
        start = file.read(65536)
    return start.startswith(MAGIC) and SAMPLE_TYPE.encode() in start


def sample_offsets(path: Path, data: memoryview) -> Iterator[SampleOffset]:
    """The offsets of the samples in a file, in order, up to its end or to where it is cut off.

    Args:
        path: For error messages.
        data: The file.

    Raises:
        FileError: At the first invalid record, unless the file merely ends within it.
    """
    schemas: set[int] = set()
    channels: set[int] = set()
    damage = scan.magic_damage(data)
    if damage is not None and len(data) >= len(MAGIC):
        raise damage.error(path)
    waiting: scan.Chunk | None = None
    indexed: set[int] = set()  # channels of the waiting chunk, according to the index after it
    for record in scan.records(data, len(MAGIC)):
        if isinstance(record, scan.RawRecord) and record.opcode == Opcode.MESSAGE_INDEX:
            _require(path, scan.check_record(data, record))
            indexed.add(scan.INDEX_HEAD.unpack_from(data, record.start)[0])
            continue
        if waiting is not None and (not indexed or indexed & channels or isinstance(record, scan.Damage)):
            yield from _offsets_in(path, data, waiting, channels)
        waiting, indexed = None, set()
        if isinstance(record, scan.Damage):
            if record.rule.startswith("cut off"):
                return
            raise record.error(path)
        if record.opcode == Opcode.DATA_END:
            return
        if record.opcode == Opcode.CHUNK:
            waiting = _require(path, scan.chunk_at(data, record))
            continue
        _require(path, scan.check_record(data, record))
        content = _require(path, scan.declaration(data, record))
        if isinstance(content, Schema) and content.name == SAMPLE_TYPE:
            schemas.add(content.id)
        elif isinstance(content, Channel) and content.schema_id in schemas:
            channels.add(content.id)
    if waiting is not None:
        yield from _offsets_in(path, data, waiting, channels)


def sample_ids(path: Path) -> list[str]:
    """The ids in a file, including those after damage that `repair` would save (raises as `sample_offsets`)."""
    with scan.mapped(path) as data:
        ids = [_id_of(path, data, offset) for offset in sample_offsets(path, data)]
        cut = next((one.offset for one in scan.records(data, len(MAGIC)) if isinstance(one, scan.Damage)), len(data))
        return ids + [decode_sample(bytes(cdr)).record.sample.id for cdr in samples_after_damage(data, cut)]


def _require(path: Path, found: _T | scan.Damage) -> _T:
    if isinstance(found, scan.Damage):
        raise found.error(path)
    return found


def _offsets_in(path: Path, data: memoryview, chunk: scan.Chunk, channels: set[int]) -> Iterator[SampleOffset]:
    for item in scan.messages_of(data, chunk.start, chunk.end):
        message = _require(path, item)
        if isinstance(message, scan.RawMessage) and message.channel in channels:
            yield SampleOffset(message.start, message.end, message.log_time_ns)


def _id_of(path: Path, data: memoryview, sample: SampleOffset) -> str:
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


def _open_samples(path: Path, unfinished: bool) -> SampleSet:
    dataset = RecordedDataset(path)
    cut = tuple(dataset.unfinished)
    if cut and not unfinished:
        dataset.close()
        raise FileError(cut[0], "is not finished: run `foretouch dataset repair`")
    return SampleSet(
        path=path,
        kind="recording",
        size=len(dataset),
        record=lambda k: dataset[k].record,
        name=dataset.name,
        identity=dataset[0].identity if len(dataset) else Identity(),
        close=dataset.close,
        unfinished=cut,
        message_counts=lambda: dataset.message_counts().to_record(),
        edits=tuple(dataset.edits.descriptions()),
    )


DATASET_FORMAT = DatasetFormat(recognise=holds_samples, open=_open_samples)
