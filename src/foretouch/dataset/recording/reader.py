# SPDX-License-Identifier: Apache-2.0
"""Reads the samples of a recorded dataset, in the order of their recording.

The offsets of the samples are found without decoding other messages. A recording that was cut off is read as far as it is
intact, and of a damaged one is found what can be saved.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any, TypeVar

from mcap.opcode import Opcode
from mcap.records import Metadata

from foretouch.dataset.record import Identity
from foretouch.dataset.recording.edits import EditLog, read_edits
from foretouch.dataset.recording.folder import is_dataset, recorded_files, recorded_sensor, session_files
from foretouch.dataset.recording.records import (
    IN_CHUNK,
    MAGIC,
    Damage,
    Declarations,
    MessageCounts,
    Record,
    RecordedMessage,
    contents,
    declared_samples,
    is_finished,
    magic_damage,
    walk,
)
from foretouch.dataset.recording.sample_codec import ABOUT, HEAD_SIZE, SAMPLE_TYPES, StoredSample, decode_sample, id_in
from foretouch.dataset.recording.verify import require_chain
from foretouch.dataset.samples import SampleSet
from foretouch.errors import DatasetError, FileError, VersionError
from foretouch.files import FileBytes, open_regular
from foretouch.tactile.channels import BIOTAC_SP

_T = TypeVar("_T")


class RecordedDataset:
    """The samples of a recorded dataset, or of one of its `.mcap` files.

    One of version 1 is only read to `convert` it. A `FileError` names file and position if the path is not a recorded dataset, or a
    manifest or recording is damaged.
    """

    def __init__(self, path: str | Path, *, convert: bool = False) -> None:
        self.path = Path(path)
        self._convert = convert
        self.files = recorded_files(self.path, convert=convert)  # MCAP files
        if self.path.is_dir():
            require_chain(self.path)
        self.stated_sensor = recorded_sensor(self.path) if self.path.is_dir() else None  # by the manifest
        self.edits = read_edits(self.path) if self.path.is_dir() else EditLog()  # which are applied to the samples
        self._samples: list[tuple[FileBytes, RecordedMessage]] = []
        self._declared: list[Declarations] = []  # by file
        self.unfinished: list[Path] = []  # files that were cut off; they are read as far as they are intact
        for file in self.files:
            data, declared = FileBytes(file), Declarations()
            found = [(data, one) for one in sample_messages(file, data, declared)]
            if is_finished(data):
                _check_count(file, data, len(found))
            else:
                self.unfinished.append(file)
            self._samples += found
            self._declared.append(declared)

    def __len__(self) -> int:
        return len(self._samples)

    def __getitem__(self, index: int) -> StoredSample:
        """One sample with the edits applied, verified by its SHA-256; a `FileError` names the position of damage."""
        stored = self.as_recorded(index)
        return stored._replace(record=self.edits.apply(stored.record))

    def __iter__(self) -> Iterator[StoredSample]:
        for k in range(len(self)):
            yield self[k]

    def as_recorded(self, index: int) -> StoredSample:
        """One sample before any edit (raises as indexing)."""
        data, message = self._samples[index]
        try:
            return decode_sample(data[message.start : message.end], self.stated_sensor, convert=self._convert)
        except DatasetError as err:
            raise FileError(data.path, str(err), field=f"sample at byte {message.start}") from err

    def message_counts(self) -> dict[str, dict[str, Any]]:
        """The message counts by topic, summed over the last ones of each recording; a `FileError` for damage."""
        total = MessageCounts()
        for file, declared in zip(self.files, self._declared, strict=True):
            require_intact(file, declared.damage)
            total.add(declared.counts or MessageCounts())
        return total.to_record()

    def name(self, index: int) -> str:
        """File and offset of a sample, for messages."""
        data, message = self._samples[index]
        return f"{data.path}[{message.start}]"


def _check_count(path: Path, data: FileBytes, found: int) -> None:
    """Compare the samples found in a finished file with the count in its summary, which has a checksum."""
    count = require_intact(path, declared_samples(data))
    if count != found:
        raise FileError(path, f"damaged: holds {found} samples, its index declares {count}", field="samples")


def recognise(path: Path) -> bool:
    """Whether a path is a recorded dataset, or an MCAP file that begins as a recording of foretouch."""
    if path.is_dir():
        return is_dataset(path)
    if path.suffix != ".mcap" or not path.is_file():
        return False
    with open_regular(path) as file:
        start = file.read(65536)
    contents = (record.content for record in walk(start) if isinstance(record, Record))
    begins = any(isinstance(content, Metadata) and content.name == ABOUT for content in contents)
    return start.startswith(MAGIC) and (begins or any(name.encode() in start for name in SAMPLE_TYPES))


def convert(path: Path) -> SampleSet:
    """The samples of a recorded dataset, also of version 1."""
    return open_set(path, unfinished=False, old=True)


def open_set(path: Path, unfinished: bool, *, old: bool = False) -> SampleSet:
    """The samples of a recorded dataset, also of version 1 if `old` is true (raises as `RecordedDataset`)."""
    dataset = RecordedDataset(path, convert=old)
    cut = tuple(dataset.unfinished)
    if cut and not unfinished:
        raise FileError(cut[0], "is not finished: run `foretouch dataset repair`")
    first = dataset[0] if len(dataset) else None
    return SampleSet(
        path=path,
        kind="recording",
        size=len(dataset),
        record=lambda k: dataset[k].record,
        name=dataset.name,
        identity=first.identity if first else Identity(),
        unfinished=cut,
        message_counts=dataset.message_counts,
        edits=tuple(dataset.edits.descriptions()),
        sensor=dataset.stated_sensor or (first.sensor if first else BIOTAC_SP),
    )


def require_intact(path: Path, found: _T | Damage) -> _T:
    """What was found; a `FileError` if it is damage."""
    if isinstance(found, Damage):
        raise found.error(path)
    return found


def sample_messages(path: Path, data: FileBytes, declared: Declarations) -> Iterator[RecordedMessage]:
    """The messages with samples in a file, in order, up to its end or to where it is cut off.

    The index after a chunk lists its channels, so chunks without samples are skipped. What the records declare is added
    to `declared`. Raises a `FileError` at the first invalid record, unless the file merely ends within it.
    """
    damage = magic_damage(data)
    if damage is not None and len(data) >= len(MAGIC):
        raise damage.error(path)
    for item in walk(data):
        if isinstance(item, Damage) and item.rule.startswith("cut off"):
            return
        record = require_intact(path, item)
        if record.opcode == Opcode.DATA_END:
            return
        declared.add(record)
        if record.opcode == Opcode.CHUNK:
            yield from _samples_of(path, data, record, declared)


def _samples_of(path: Path, data: FileBytes, chunk: Record, declared: Declarations) -> Iterator[RecordedMessage]:
    indexed = set()  # channels of the chunk, according to the index after it
    for record in walk(data, chunk.end):
        if isinstance(record, Damage) or record.opcode != Opcode.MESSAGE_INDEX:
            break
        indexed.add(record.content)
    for item in walk(data, chunk.content.start, chunk.content.end, IN_CHUNK):
        record = require_intact(path, item)
        declared.add(record)  # declarations stand before the first message
        if not isinstance(record.content, RecordedMessage):
            continue
        if declared.type_of(record.content.channel) in SAMPLE_TYPES:
            yield record.content
        elif indexed and not set(SAMPLE_TYPES).intersection(map(declared.type_of, indexed)):
            return


def salvaged(data: FileBytes, start: int = len(MAGIC)) -> Iterator[RecordedMessage | Damage]:
    """From offset `start` on, the messages of intact chunks, and the damage."""
    for item in contents(data, Declarations(), start):
        if not isinstance(item, Record):
            yield item


def readable(data: FileBytes, message: RecordedMessage) -> StoredSample | None:
    """The sample in a message, None if it is none or incomplete; a `VersionError` if it is of another version."""
    try:
        return decode_sample(data[message.start : message.end])
    except VersionError:
        raise
    except DatasetError:
        return None


def recorded_ids(path: Path) -> set[str]:
    """The ids in a dataset, including those after damage that `repair` would save; a `FileError` for other damage."""
    ids = set()
    for file in session_files(path):
        data = FileBytes(file)
        cut = next((one.offset for one in walk(data) if isinstance(one, Damage)), len(data))
        found = list(sample_messages(file, data, Declarations()))
        if is_finished(data) and declared_samples(data) != len(found):  # what is declared is damaged
            cut = len(MAGIC)
        saved = (one for one in salvaged(data, cut) if not isinstance(one, Damage) and readable(data, one))
        ids |= {_id_of(file, data, message) for message in (*found, *saved)}
    return ids


def _id_of(path: Path, data: FileBytes, sample: RecordedMessage) -> str:
    try:
        return id_in(data[sample.start : min(sample.end, sample.start + HEAD_SIZE)])
    except ValueError as err:
        rule = f"damaged: the id of a sample cannot be read: {err}"
        raise FileError(path, rule, field=f"byte {sample.start}") from err
