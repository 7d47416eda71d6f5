# SPDX-License-Identifier: Apache-2.0
"""The records of a recording and its messages, found without trusting any length in it.

Only requested bytes are read, and no length in the file can make the reader allocate more memory than the size of the
file. Reading, verification and repair all use one `RecordingFile`.

Of the message counts in a recording, received = written + dropped (by reason), for each topic. Messages that the
middleware lost before they arrived were never received; they are counted separately.
"""

import json
import re
import struct
from collections import Counter, deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Any, Final, NamedTuple, Self

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Header, Metadata, Schema
from mcap.writer import MCAP0_MAGIC

from foretouch.dataset.recording.sample_codec import ABOUT, COUNTS, SAMPLE_TYPES
from foretouch.errors import DatasetError, FileError, described
from foretouch.files import COUNT, FileBytes, parse_json, require_schema

MAGIC: Final[bytes] = MCAP0_MAGIC

_HEAD = struct.Struct("<BQ")  # opcode, length
_CHUNK = struct.Struct("<QQQIIQ")  # start, end, size, crc, compression (none), size of the data
_MESSAGE = struct.Struct("<HIQQ")  # channel, sequence, times of log and publication
_INDEX = struct.Struct("<HI")  # channel, size of the entries
_FOOTER = struct.Struct("<BQQQI")  # opcode, length, start of the index, of its offsets, checksum
_CHUNK_START: Final = re.compile(rb"\x06(?=.{8}.{24}.{4}\x00{4})", re.DOTALL)
_DECLARED: Final[dict[Opcode, Any]] = {
    Opcode.HEADER: Header,
    Opcode.SCHEMA: Schema,
    Opcode.CHANNEL: Channel,
    Opcode.METADATA: Metadata,
}
_ALLOWED: Final = {Opcode.CHUNK, Opcode.MESSAGE, Opcode.MESSAGE_INDEX, Opcode.DATA_END, *_DECLARED}


class Damage(NamedTuple):
    """An invalid part of a file."""

    offset: int  # its position [bytes]
    rule: str  # the rule that it breaks

    def error(self, path: Path) -> FileError:
        """As an error that names file and position."""
        return FileError(path, self.rule, field=f"byte {self.offset}")


class RecordedMessage(NamedTuple):
    """A message in a file; topic and type are "" if its channel is not declared."""

    topic: str
    type: str
    sequence: int
    log_time_ns: int
    publish_time_ns: int
    start: int  # of its CDR in the file [bytes]
    end: int

    @property
    def is_sample(self) -> bool:
        """Whether it holds a sample."""
        return self.type in SAMPLE_TYPES


class _Record(NamedTuple):
    opcode: int
    offset: int
    start: int  # of its content
    end: int


class RecordingFile:
    """One file of a recording; `messages` walks over it, and fills the attributes meanwhile.

    Attributes:
        about: Facts on hand, camera and versions.
        counts: The last message counts; None if there are none.
        channels, schemas: What is declared, by number; later declarations replace earlier ones.
        finished: Whether it was closed, so that it has an index.
    """

    def __init__(self, path: Path) -> None:
        self.path, self.data = path, FileBytes(path)
        self.about: dict[str, str] = {}
        self.counts: MessageCounts | None = None
        self.channels: dict[int, Channel] = {}
        self.schemas: dict[int, Schema] = {}
        self.finished = len(self.data) > 2 * len(MAGIC) and self.data[-len(MAGIC) :] == MAGIC

    def messages(self, *, samples_only: bool = False) -> Iterator[RecordedMessage | Damage]:
        """The messages in order, and all damage, after which it continues at the next intact chunk.

        With `samples_only`, no checksum is verified, and chunks that begin with another message are skipped: each sample has
        a chunk of its own.
        """
        data, start, index = self.data, len(MAGIC), self._index()
        if data[:start] != MAGIC:
            yield Damage(0, "is not an MCAP file: it does not begin as one" if len(data) else "is empty")
        if not samples_only and not isinstance(index, Damage):  # it repeats what damaged chunks may have declared
            deque(self._records(*index), 0)
        while start < len(data):
            for one in self._records(start, len(data)):
                if isinstance(one, Damage):
                    yield one
                    break
                if one.opcode == Opcode.DATA_END:
                    if not samples_only:
                        yield from self._end_damage(one, index)
                    return
                if one.opcode == Opcode.CHUNK and not samples_only and not self._intact(one):
                    yield Damage(one.offset, "damaged: a chunk that does not match its checksum")
                elif one.opcode == Opcode.CHUNK:
                    yield from self._in_chunk(one, samples_only)
            else:
                return
            start = self.next_chunk(one.offset + 1)

    def next_chunk(self, start: int) -> int:
        """Offset of the first chunk with a valid checksum from `start` on; the size of the file if there is none."""
        for at in self.data.find_all(_CHUNK_START, 64, start, len(self.data)):
            found = next(self._records(at, len(self.data)))
            if isinstance(found, _Record) and self._intact(found):
                return at
        return len(self.data)

    def _intact(self, chunk: _Record) -> bool:
        crc = _CHUNK.unpack(self.data[chunk.start : chunk.start + _CHUNK.size])[3]
        return self.data.crc32(chunk.start + _CHUNK.size, chunk.end) == int(crc)

    def _in_chunk(self, chunk: _Record, samples_only: bool) -> Iterator[RecordedMessage | Damage]:
        for one in self._records(chunk.start + _CHUNK.size, chunk.end):
            if isinstance(one, Damage):
                yield one
            elif one.opcode == Opcode.MESSAGE:
                start = one.start + _MESSAGE.size
                number, sequence, logged, published = _MESSAGE.unpack(self.data[one.start : start])
                channel = self.channels.get(number)
                schema = None if channel is None else self.schemas.get(channel.schema_id)
                names = ("", "") if channel is None or schema is None else (channel.topic, schema.name)
                found = RecordedMessage(*names, sequence, logged, published, start, one.end)
                if samples_only and not found.is_sample:
                    return
                yield found

    def _records(self, start: int, end: int) -> Iterator[_Record | Damage]:
        """The records between two offsets, which are declared; it ends at damage that leaves open where the next one begins."""
        while start < end:
            left = end - start - _HEAD.size
            opcode, length = _HEAD.unpack(self.data[start : start + _HEAD.size]) if left >= 0 else (0, 0)
            if length > left:
                yield Damage(start, f"cut off or damaged: a record of {length} bytes, {max(0, left)} are left")
                return
            if opcode not in _ALLOWED:
                yield Damage(start, f"damaged: a record of number {opcode} is not allowed here")
                return
            record = _Record(opcode, start, start + _HEAD.size, start + _HEAD.size + length)
            fault = self._declare(record)
            yield fault or record
            if fault:
                return
            start = record.end

    def _declare(self, record: _Record) -> Damage | None:
        """Add what a record declares, if it is a declaration; the damage of one whose content is not what it must be."""
        size, kind = record.end - record.start, _DECLARED.get(Opcode(record.opcode))
        head = self.data[record.start : record.start + _CHUNK.size].ljust(_CHUNK.size)
        if record.opcode == Opcode.CHUNK:
            _, _, unpacked, _, compression, packed = _CHUNK.unpack(head)
            fits = unpacked == packed == size - _CHUNK.size and not compression
        elif record.opcode == Opcode.MESSAGE_INDEX:
            fits = _INDEX.unpack(head[: _INDEX.size])[1] == size - _INDEX.size
        else:
            fits = (
                size == 4
                if record.opcode == Opcode.DATA_END
                else record.opcode != Opcode.MESSAGE or size >= _MESSAGE.size
            )
        if not fits:
            return Damage(record.offset, "damaged or compressed: the content of a record is not as long as it states")
        if kind is None:
            return None
        stream = ReadDataStream(BytesIO(self.data[record.start : record.end]))
        try:
            content: Any = kind.read(stream)
            if stream.count != size:
                raise ValueError("extra bytes")
            if isinstance(content, Metadata) and content.name == COUNTS:
                self.counts = MessageCounts.from_mapping(content.metadata)
        except (McapError, ValueError, struct.error, EOFError, OverflowError, DatasetError) as err:
            return Damage(record.offset, f"damaged {kind.__name__.lower()}: {described(err)}")
        if isinstance(content, Schema):
            self.schemas[content.id] = content
        elif isinstance(content, Channel):
            self.channels[content.id] = content
        elif isinstance(content, Metadata) and content.name == ABOUT:
            self.about = content.metadata
        return None

    def _index(self) -> tuple[int, int] | Damage:
        """Start and end of the index of a finished file, verified by its checksum."""
        data, at = self.data, len(self.data) - len(MAGIC) - _FOOTER.size
        if at < len(MAGIC) or not self.finished:
            return Damage(max(0, len(data) - len(MAGIC)), "cut off or damaged: the file does not end as an MCAP file")
        opcode, _, start, _, crc = _FOOTER.unpack(data[at : at + _FOOTER.size])
        if opcode != Opcode.FOOTER or start > at or data.crc32(start, at + _FOOTER.size - 4) != crc:
            return Damage(at, "damaged: the index at the end does not match its checksum")
        return start, at

    def _end_damage(self, record: _Record, index: tuple[int, int] | Damage) -> Iterator[Damage]:
        """Compare the checksum in the record that ends the data, and what follows it."""
        if self.data[record.start : record.end] != self.data.crc32(0, record.offset).to_bytes(4, "little"):
            yield Damage(record.offset, "damaged: the bytes before do not match this checksum")
        if isinstance(index, Damage):
            yield index
        elif index[0] != record.end:
            yield Damage(record.end, "damaged: the index does not follow the data")


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
