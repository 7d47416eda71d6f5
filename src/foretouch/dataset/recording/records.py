# SPDX-License-Identifier: Apache-2.0
"""Walks over the records of a recording without trusting any length in it.

Only requested bytes are read, and no length in the file can make the reader allocate more memory than the size of the
file. Verification, repair and reading all use `walk`.

Of the message counts in a recording, received = written + dropped (by reason), for each topic. Messages that the
middleware lost before they arrived were never received; they are counted separately.
"""

import json
import re
import struct
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Any, Final, NamedTuple, Self

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, ChunkIndex, DataEnd, Header, Metadata, Schema, Statistics
from mcap.writer import MCAP0_MAGIC

from foretouch.dataset.recording.sample_codec import ABOUT, COUNTS, SAMPLE_TYPES
from foretouch.errors import DatasetError, FileError
from foretouch.files import COUNT, FileBytes, parse_json, require_schema

MAGIC: Final[bytes] = MCAP0_MAGIC

_HEAD = struct.Struct("<BQ")  # opcode, length
_CHUNK = struct.Struct("<QQQIIQ")  # start, end, size, crc, compression (none), size of the data
_MESSAGE = struct.Struct("<HIQQ")
_INDEX = struct.Struct("<HI")  # channel, size of the entries
_FOOTER = struct.Struct("<BQQQI")  # opcode, length, start of the summary, of its offsets, checksum
_CHUNK_START: Final = re.compile(rb"\x06(?=.{8}.{24}.{4}\x00{4})", re.DOTALL)
_PARSED: Final = {
    Opcode.HEADER: Header,
    Opcode.SCHEMA: Schema,
    Opcode.CHANNEL: Channel,
    Opcode.METADATA: Metadata,
    Opcode.DATA_END: DataEnd,
    Opcode.CHUNK_INDEX: ChunkIndex,
    Opcode.STATISTICS: Statistics,
}
_DECLARATIONS: Final = {Opcode.SCHEMA, Opcode.CHANNEL}
_IN_DATA: Final = _DECLARATIONS | {Opcode.HEADER, Opcode.CHUNK, Opcode.MESSAGE_INDEX, Opcode.METADATA, Opcode.DATA_END}
IN_CHUNK: Final = _DECLARATIONS | {Opcode.MESSAGE}
IN_SUMMARY: Final = _DECLARATIONS | {
    Opcode.STATISTICS,
    Opcode.CHUNK_INDEX,
    Opcode.METADATA_INDEX,
    Opcode.SUMMARY_OFFSET,
}


class Damage(NamedTuple):
    """An invalid part of a file."""

    offset: int  # its position [bytes]
    rule: str  # the rule that it breaks

    def error(self, path: Path) -> FileError:
        """As an error that names file and position."""
        return FileError(path, self.rule, field=f"byte {self.offset}")


class Chunk(NamedTuple):
    """Start and end of the data of a chunk in the file, and their declared checksum."""

    start: int
    end: int
    crc: int

    def intact(self, data: FileBytes) -> bool:
        """Whether the data match the checksum."""
        return data.crc32(self.start, self.end) == self.crc


class RecordedMessage(NamedTuple):
    """A message in a chunk: `start` and `end` of its CDR in the file."""

    channel: int
    sequence: int
    log_time_ns: int
    publish_time_ns: int
    start: int
    end: int


class Record(NamedTuple):
    """One record of a file from `offset` to `end`; the content of a message index is its channel."""

    opcode: int
    offset: int
    end: int
    content: Any


def magic_damage(data: FileBytes) -> Damage | None:
    """The fault of the first bytes, if there is one."""
    if len(data) == 0:
        return Damage(0, "is empty")
    return None if data[: len(MAGIC)] == MAGIC else Damage(0, "is not an MCAP file: it does not begin as one")


def walk(
    data: FileBytes | bytes, start: int = len(MAGIC), end: int | None = None, allowed: set[Opcode] = _IN_DATA
) -> Iterator[Record | Damage]:
    """The records from offset `start` to `end`, by default the end of the file; a `Damage` for each that is invalid.

    The walk ends at damage that leaves open where the next record begins.
    """
    end = len(data) if end is None else end
    while start < end:
        left = end - start - _HEAD.size
        if left < 0:
            yield Damage(start, f"cut off: {end - start} bytes are not a record")
            return
        opcode, length = _HEAD.unpack(data[start : start + _HEAD.size])
        if length > left:
            yield Damage(start, f"cut off or damaged: a record of {length} bytes, {left} are left")
            return
        following = start + _HEAD.size + length
        content: Any = f"a record of number {opcode} is not allowed here"
        if opcode in allowed:
            content = _content(data, opcode, start + _HEAD.size, following)
        if isinstance(content, str):
            yield Damage(start, f"damaged: {content}")
        else:
            yield Record(opcode, start, following, content)
        if opcode == 0:
            return
        start = following


def contents(
    data: FileBytes, declared: "Declarations", start: int = len(MAGIC)
) -> Iterator[Record | RecordedMessage | Damage]:
    """The records from offset `start` on, after each chunk the messages in it, and all damage.

    After damage it continues at the next intact chunk, and it ends with the record that ends the data. What the records
    declare is added to `declared`.
    """
    while start < len(data):
        for item in walk(data, start):
            if isinstance(item, Damage):
                yield item
                break
            yield from _content_of(data, item, declared)
            if item.opcode == Opcode.DATA_END:
                return
        else:
            return
        start = next_chunk(data, item.offset + 1)


def _content_of(
    data: FileBytes, record: Record, declared: "Declarations"
) -> Iterator[Record | RecordedMessage | Damage]:
    if damage := declared.add(record):
        yield damage
    chunk = record.content
    if not isinstance(chunk, Chunk):
        yield record
    elif not chunk.intact(data):
        yield Damage(record.offset, "damaged: a chunk that does not match its checksum")
    else:
        yield record
        for inner in walk(data, chunk.start, chunk.end, IN_CHUNK):
            if isinstance(inner, Record):
                declared.add(inner)
            if isinstance(inner, Damage) or isinstance(inner.content, RecordedMessage):
                yield inner if isinstance(inner, Damage) else inner.content


def next_chunk(data: FileBytes, start: int) -> int:
    """Offset of the first chunk with a valid checksum from `start` on; the size of the file if there is none."""
    for at in data.find_all(_CHUNK_START, 64, start, len(data)):
        found = next(walk(data, at))
        if isinstance(found, Record) and found.content.intact(data):
            return at
    return len(data)


def is_finished(data: FileBytes) -> bool:
    """Whether a recording was closed, so that it has an index."""
    return len(data) > 2 * len(MAGIC) and data[-len(MAGIC) :] == MAGIC


def summary_of(data: FileBytes) -> tuple[int, int] | Damage:
    """Start and end of the summary of a finished file, verified by its checksum."""
    at = len(data) - len(MAGIC) - _FOOTER.size
    if at < len(MAGIC) or not is_finished(data):
        return Damage(max(0, len(data) - len(MAGIC)), "cut off or damaged: the file does not end as an MCAP file")
    opcode, length, start, _, crc = _FOOTER.unpack(data[at : at + _FOOTER.size])
    if opcode != Opcode.FOOTER or length != _FOOTER.size - _HEAD.size or not len(MAGIC) <= start <= at:
        return Damage(at, "damaged: the footer of a finished recording is not a footer")
    if data.crc32(start, at + _FOOTER.size - 4) != crc:
        return Damage(start, "damaged: the index at the end does not match its checksum")
    return start, at


def declared_samples(data: FileBytes) -> int | Damage:
    """The number of samples by the summary of a finished file, which has a checksum."""
    summary = summary_of(data)
    if isinstance(summary, Damage):
        return summary
    declared, counts = Declarations(), {}
    for record in walk(data, *summary, IN_SUMMARY):
        if isinstance(record, Damage):
            return record
        declared.add(record)
        if isinstance(record.content, Statistics):
            counts = record.content.channel_message_counts
    return sum(count for channel, count in counts.items() if declared.type_of(channel) in SAMPLE_TYPES)


def _content(data: FileBytes | bytes, opcode: int, start: int, end: int) -> Any:
    """The content of a record; a text says why it is damaged."""
    if opcode == Opcode.CHUNK:
        if end - start < _CHUNK.size:
            return "a chunk too short for its head"
        _, _, size, crc, compression, data_size = _CHUNK.unpack(data[start : start + _CHUNK.size])
        if compression:
            return "a compressed chunk, which foretouch does not support"
        if not size == data_size == end - start - _CHUNK.size:
            return "the sizes of a chunk do not add up"
        return Chunk(start + _CHUNK.size, end, crc)
    if opcode == Opcode.MESSAGE:
        if end - start < _MESSAGE.size:
            return "a message too short for its head"
        channel, sequence, log_time_ns, publish_time_ns = _MESSAGE.unpack(data[start : start + _MESSAGE.size])
        return RecordedMessage(channel, sequence, log_time_ns, publish_time_ns, start + _MESSAGE.size, end)
    if opcode == Opcode.MESSAGE_INDEX:
        size = end - start - _INDEX.size
        if size < 0:
            return "an index too short for its head"
        channel, declared = _INDEX.unpack(data[start : start + _INDEX.size])
        return "the sizes of an index do not add up" if size % 16 or size != declared else channel
    kind: Any = _PARSED.get(Opcode(opcode))
    if kind is None:
        return None
    name, stream = kind.__name__.lower(), ReadDataStream(BytesIO(data[start:end]))
    try:
        content = kind.read(stream)
    except (McapError, ValueError, struct.error, EOFError, OverflowError) as err:
        return f"no {name}: {' '.join(str(err).split()) or type(err).__name__}"
    return content if stream.count == end - start else f"extra bytes after a {name}"


_COUNTED: Final = ("received", "written", "lost")


@dataclass
class TopicCounts:
    """Counts of one topic."""

    received: int = 0  # messages that arrived
    written: int = 0  # messages in the file
    dropped: Counter[str] = field(default_factory=Counter)  # messages discarded, by reason
    lost: int = 0  # messages that the middleware lost before they arrived

    @property
    def pending(self) -> int:
        """Received, and neither written nor dropped yet: in a queue or in the next chunk."""
        return self.received - self.written - self.dropped.total()

    def drop(self, reason: str, count: int) -> None:
        """Count messages as discarded."""
        if count > 0:
            self.dropped[reason] += count


@dataclass
class MessageCounts:
    """The counts of a recording, by topic."""

    topics: dict[str, TopicCounts] = field(default_factory=dict)

    def topic(self, name: str) -> TopicCounts:
        """The counts of one topic, created if needed."""
        return self.topics.setdefault(name, TopicCounts())

    def add(self, other: "MessageCounts") -> None:
        """Add the counts of another recording."""
        for name, theirs in other.topics.items():
            counts = self.topic(name)
            counts.received += theirs.received
            counts.written += theirs.written
            counts.dropped.update(theirs.dropped)
            counts.lost += theirs.lost

    def to_record(self) -> dict[str, dict[str, Any]]:
        """By topic, in plain types."""
        return {
            name: {**vars(counts), "dropped": dict(sorted(counts.dropped.items()))}
            for name, counts in sorted(self.topics.items())
        }

    def to_mapping(self) -> dict[str, str]:
        """As MCAP metadata: one JSON text a topic."""
        return {name: json.dumps(counts) for name, counts in self.to_record().items()}

    @classmethod
    def from_mapping(cls, mapping: Mapping[str, str]) -> Self:
        """Parse the result of `to_mapping`; a `DatasetError` if a text is invalid."""
        result = cls()
        for name, text in mapping.items():
            try:
                counts = parse_json(text)
                require_schema("", counts, {**dict.fromkeys(_COUNTED, COUNT), "dropped": {"*": COUNT}})
                received, written, lost = (counts[key] for key in _COUNTED)
                dropped = Counter(counts["dropped"])
            except (ValueError, FileError) as err:
                raise DatasetError(f"message counts: {name}: {text[:80]!r} holds no counts") from err
            result.topics[name] = TopicCounts(received, written, dropped, lost)
        return result


class Declarations:
    """What the records of a file declare; later ones replace earlier ones."""

    def __init__(self) -> None:
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}
        self.about: dict[str, str] = {}
        self.counts: MessageCounts | None = None
        self.damage: Damage | None = None  # of the last counts that cannot be read

    def add(self, record: Record) -> Damage | None:
        """Add what a record declares, if it is a declaration; the damage of message counts that cannot be read."""
        content = record.content
        if isinstance(content, Schema):
            self.schemas[content.id] = content
        elif isinstance(content, Channel):
            self.channels[content.id] = content
        elif isinstance(content, Metadata) and content.name == ABOUT:
            self.about = content.metadata
        elif isinstance(content, Metadata) and content.name == COUNTS:
            try:
                self.counts = MessageCounts.from_mapping(content.metadata)
            except DatasetError as err:
                self.damage = Damage(record.offset, str(err))
                return self.damage
        return None

    def type_of(self, channel: int) -> str:
        """Type of the messages of a channel; "" if it is not declared."""
        declared = self.channels.get(channel)
        schema = None if declared is None else self.schemas.get(declared.schema_id)
        return "" if schema is None else schema.name
