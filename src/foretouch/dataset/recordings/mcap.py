# SPDX-License-Identifier: Apache-2.0
"""Reads and writes MCAP files: what of a recording depends on its bytes.

`McapReader` reads files with any of their optional parts, also cut off or damaged ones, without trusting any length in them.
`mcap` parses the records; its readers, like the readers of `rosbags`, require a complete file with particular indexes. Only
requested bytes are read. No length in the file can make the reader allocate more memory than the size of the file, or of
a chunk that really unpacks to so much.

`McapFile` is a new file that always ends where a chunk ends. `mcap.writer` makes the bytes. Each chunk is passed to the system in
one call, and the remains of a failed write are cut off again. By default chunks are not compressed: a reader finds a message by its
offset, and one damaged byte costs one chunk.
"""

import heapq
import os
import re
import struct
import sys
import zlib
from collections import Counter, deque
from collections.abc import Collection, Iterator, Sequence
from contextlib import suppress
from io import BytesIO
from operator import itemgetter
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Final, NamedTuple

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Header, Message, Metadata, Schema, Statistics
from mcap.writer import MCAP0_MAGIC, CompressionType, Writer

from foretouch import __version__
from foretouch.base.files import FileBytes, system_errors
from foretouch.errors import DatasetError, FileError, described

LIBRARY: Final = f"foretouch {__version__}"
MAGIC: Final[bytes] = MCAP0_MAGIC

_HEAD = struct.Struct("<BQ")  # opcode, length
_CHUNK = struct.Struct("<QQQII")  # start, end, size, crc, length of the name of the compression
_MESSAGE = struct.Struct("<HIQQ")  # channel, sequence, times of log and publication
_FOOTER = struct.Struct("<BQQQI")  # opcode, length, start of the index, of its offsets, checksum
_CHUNK_START: Final = re.compile(rb"\x06(?=.{8}.{24}.{4}(?:\x00{4}|\x04\x00{3}zstd|\x03\x00{3}lz4))", re.DOTALL)
_UNPACKERS: Final[dict[str, Any]] = {
    "": lambda packed: packed,
    "zstd": lambda packed: zstandard.ZstdDecompressor().stream_reader(packed, read_across_frames=True),
    "lz4": lz4.frame.open,
}
_BLOCK: Final = 1 << 20
_MOST_UNPACKED: Final = 1 << 30  # of one chunk [bytes]
_PARSED: Final[dict[int, Any]] = {
    Opcode.HEADER: Header,
    Opcode.SCHEMA: Schema,
    Opcode.CHANNEL: Channel,
    Opcode.METADATA: Metadata,
    Opcode.STATISTICS: Statistics,
}
_EXTRAS: Final = {Opcode.ATTACHMENT, Opcode.METADATA}
_OWN_USE: Final = range(0x80, 0x100)  # records of applications, which readers skip
_IN_CHUNK: Final = {Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE, *_OWN_USE}
_IN_DATA: Final = {
    *_IN_CHUNK, Opcode.HEADER, Opcode.CHUNK, Opcode.MESSAGE_INDEX, Opcode.ATTACHMENT, Opcode.METADATA, Opcode.DATA_END,
}  # fmt: skip
_IN_INDEX: Final = {
    *_IN_CHUNK, Opcode.CHUNK_INDEX, Opcode.ATTACHMENT_INDEX, Opcode.STATISTICS, Opcode.METADATA_INDEX, Opcode.SUMMARY_OFFSET,
}  # fmt: skip


class Damage(NamedTuple):
    """An invalid part of a file."""

    offset: int  # its position [bytes]
    rule: str  # the rule that it breaks

    def error(self, path: Path) -> FileError:
        """Make an error that names file and position."""
        return FileError(path, self.rule, field=f"byte {self.offset}")


class Record(NamedTuple):
    """A record in a file, or in the content of a chunk."""

    opcode: int
    offset: int  # of the record [bytes]
    start: int  # of its content
    end: int  # also where the file ends before


class RecordedMessage(NamedTuple):
    """A message in a file; its topic is "" if its channel is not declared, its type if its schema is not."""

    topic: str
    type: str
    sequence: int
    log_time_ns: int
    publish_time_ns: int
    channel: int  # its number in the file
    start: int  # of its data in the file, or in the content of its chunk [bytes]
    end: int
    chunk: Record | None  # the compressed chunk that it is in

    @property
    def offset(self) -> int:
        """Position of the message in the file, or of its chunk [bytes]."""
        return self.start if self.chunk is None else self.chunk.offset


class _Chunk(NamedTuple):
    """The head of a chunk."""

    first_ns: int  # time of its first message
    size: int  # of its content [bytes]
    crc: int  # of its content; 0 if it was not computed
    compression: str
    start: int  # of the packed content in the file [bytes]
    end: int  # as stated, which may be behind the end of the file


class McapReader:
    """One MCAP file; `messages` walks over it, and fills the attributes meanwhile.

    Attributes:
        header: Profile and library.
        channels, schemas: What is declared, by number; later declarations replace earlier ones.
        metadata: The last one of each name.
        extras: Attachments and metadata in order.
        statistics: Counts in the index; None without them.
        compression: Of the latest chunk.
        finished: Whether it was closed, so that it ends as an MCAP file does.
    """

    def __init__(self, path: Path) -> None:
        self.path, self.data = path, FileBytes(path)
        self.header = Header("", "")
        self.channels: dict[int, Channel] = {}
        self.schemas: dict[int, Schema] = {}
        self.metadata: dict[str, dict[str, str]] = {}
        self.extras: list[Record] = []
        self.statistics: Statistics | None = None
        self.compression = ""
        self.finished = len(self.data) > 2 * len(MAGIC) and self.data[-len(MAGIC) :] == MAGIC
        # Offset and content of the latest compressed chunk; replaced as a whole, since threads share it.
        self._unpacked: tuple[int, bytes] = (-1, b"")

    def __getstate__(self) -> dict[str, Any]:
        return {**vars(self), "_unpacked": (-1, b"")}

    def messages(self, only: Collection[str] = ()) -> Iterator[RecordedMessage | Damage]:
        """Iterate over the messages in the order of the file, and all damage, after which it continues at the next intact chunk.

        With types in `only`, no checksum is verified, and uncompressed chunks that begin with a message of another type are
        skipped.
        """
        for record in self._top(verified=not only):
            if isinstance(record, Damage):
                yield record
            elif record.opcode == Opcode.MESSAGE:
                yield self._message(self.data, record, None)
            elif record.opcode == Opcode.CHUNK:
                yield from self._in_chunk(record, only)

    def in_time(self, topics: Collection[str]) -> Iterator[tuple[RecordedMessage, bytes] | Damage]:
        """Iterate over the messages of some topics with their data, in order of their log times, and all damage at the end."""
        faults: list[Damage] = []
        bare: list[tuple[int, RecordedMessage]] = []
        runs: list[Iterator[tuple[int, Any]]] = []
        for record in self._top(verified=False):
            if isinstance(record, Damage):
                faults.append(record)
            elif record.opcode == Opcode.CHUNK and topics:
                runs.append(self._chunk_in_time(record, topics, faults))
            elif record.opcode == Opcode.MESSAGE:
                message = self._message(self.data, record, None)
                if message.topic in topics:
                    bare.append((message.log_time_ns, message))
        bare.sort(key=itemgetter(0))
        in_file = ((time_ns, (message, self.content(message))) for time_ns, message in bare)
        for _, message in heapq.merge(in_file, *runs, key=itemgetter(0)):
            if message is not None:
                yield message
        yield from faults
        if not faults and isinstance(index := self._read_index(), Damage):
            yield index

    def count_messages(self) -> Counter[int]:
        """Return the number of messages by channel, all of which are then declared; by the index, else by a walk over the file."""
        self._read_index()
        counts = Counter(self.statistics.channel_message_counts if self.statistics else ())
        declared = (self.channels.get(number) for number in counts)
        if (
            all(channel and (not channel.schema_id or channel.schema_id in self.schemas) for channel in declared)
            and counts
        ):
            return counts
        return Counter(message.channel for message in self.messages() if isinstance(message, RecordedMessage))

    def content(self, message: RecordedMessage) -> bytes:
        """Return the data of a message."""
        source = self.data if message.chunk is None else self._unpack(message.chunk)
        return source[message.start : message.end]

    def next_chunk(self, start: int) -> int:
        """Return the offset of the first intact chunk from `start` on; the size of the file without one."""
        for at in self.data.find_all(_CHUNK_START, 64, start, len(self.data)):
            record = next(self._records(self.data, at, len(self.data), _IN_DATA))
            if isinstance(record, Record):
                head = self._head(record)
                if not self._fault(record, head, unpacked=bool(head.compression)):
                    return at
        return len(self.data)

    def _top(self, *, verified: bool) -> Iterator[Record | Damage]:
        """Iterate over the records in front of the index, and all damage of them."""
        data = self.data
        start = len(MAGIC)
        index = self._read_index()
        self.extras.clear()
        if data[:start] != MAGIC:
            yield Damage(0, "is not an MCAP file: it does not begin as one" if len(data) else "is empty")
        while start < len(data):
            for item in self._records(data, start, len(data), _IN_DATA):
                yield item
                if isinstance(item, Damage):
                    break
                if item.opcode == Opcode.DATA_END:
                    if verified:
                        yield from self._end_damage(item, index)
                    return
                if (
                    item.opcode == Opcode.ATTACHMENT
                    and verified
                    and not self._fits(item.end - 4, item.start, item.end - 4)
                ):
                    yield Damage(item.offset, "damaged: an attachment that does not match its checksum")
            else:
                return
            start = self.next_chunk(item.offset + 1)

    def _in_chunk(
        self, record: Record, only: Collection[str] = (), *, unpacked: bool = False
    ) -> Iterator[RecordedMessage | Damage]:
        head = self._head(record)
        self.compression = head.compression
        packed, is_cut = record if head.compression or unpacked else None, head.end > record.end
        fault = "" if only and not packed else self._fault(record, head, unpacked=packed is not None)
        if fault:
            yield Damage(record.offset, fault)
            return
        source = self._unpack(record) if packed else self.data
        start, end = (0, len(source)) if packed else (head.start, record.end)
        for item in self._records(source, start, end, _IN_CHUNK):
            if isinstance(item, Damage):
                if not is_cut:  # else its last message is cut off, too
                    yield Damage(record.offset if packed else item.offset, item.rule)
            elif item.opcode == Opcode.MESSAGE:
                message = self._message(source, item, packed)
                if only and not packed and message.type not in only:
                    return
                yield message

    def _chunk_in_time(
        self, record: Record, topics: Collection[str], faults: list[Damage]
    ) -> Iterator[tuple[int, tuple[RecordedMessage, bytes] | None]]:
        """Iterate over the messages of a chunk by time, after None at the time of the first: until then the chunk is not read."""
        yield self._head(record).first_ns, None
        messages = []
        for item in self._in_chunk(record, unpacked=True):
            if isinstance(item, Damage):
                faults.append(item)
            elif item.topic in topics:
                messages.append((item.log_time_ns, (item, self.content(item))))
        yield from sorted(messages, key=itemgetter(0))

    def _message(self, source: FileBytes | bytes, record: Record, chunk: Record | None) -> RecordedMessage:
        start = record.start + _MESSAGE.size
        number, sequence, logged_ns, sent_ns = _MESSAGE.unpack(source[record.start : start])
        channel = self.channels.get(number)
        schema = None if channel is None else self.schemas.get(channel.schema_id)
        names = "" if channel is None else channel.topic, "" if schema is None else schema.name
        return RecordedMessage(*names, sequence, logged_ns, sent_ns, number, start, record.end, chunk)

    def _head(self, chunk: Record) -> _Chunk:
        """Return the head of a chunk, whose record was found valid."""
        start = chunk.start + _CHUNK.size
        first_ns, _, size, crc, length = _CHUNK.unpack(self.data[chunk.start : start])
        compression = self.data[start : start + length].decode("utf-8", "replace")
        start += length + 8
        return _Chunk(
            first_ns, size, crc, compression, start, start + int.from_bytes(self.data[start - 8 : start], "little")
        )

    def _fault(self, record: Record, head: _Chunk, *, unpacked: bool) -> str:
        """Return what is wrong with the content of a chunk; "" if nothing, or if it is cut off."""
        if head.compression not in _UNPACKERS:
            return f"a chunk is compressed by {head.compression!r}, which is not supported"
        if head.size > _MOST_UNPACKED and head.compression:
            return f"a chunk unpacks to {head.size} bytes, more than {_MOST_UNPACKED}"
        if head.end > record.end:
            return ""
        if unpacked:
            content = self._unpack(record)
            size = len(content)
            fits = not head.crc or head.crc == zlib.crc32(content)
        else:
            size = head.end - head.start
            fits = not head.crc or head.crc == self.data.crc32(head.start, record.end)
        return "" if fits and size == head.size else "damaged: a chunk that does not match its checksum or size"

    def _unpack(self, record: Record) -> bytes:
        """Return the content of a chunk, as far as it unpacks."""
        at, content = self._unpacked
        if at != record.offset:
            head = self._head(record)
            parts = list[bytes]()
            size = 0
            packed = BytesIO(self.data[head.start : record.end])
            with suppress(zstandard.ZstdError, EOFError, RuntimeError):  # of a cut or damaged one
                stream = _UNPACKERS[head.compression](packed)
                while size <= head.size and (part := stream.read1(_BLOCK)):
                    parts.append(part)
                    size += len(part)
            content = b"".join(parts)
            self._unpacked = record.offset, content
        return content

    def _records(
        self, source: FileBytes | bytes, start: int, end: int, allowed: Collection[int]
    ) -> Iterator[Record | Damage]:
        """Iterate over the records between two offsets, which are declared; it ends at damage that leaves open where the next one begins."""
        while start < end:
            left = end - start - _HEAD.size
            opcode, length = _HEAD.unpack(source[start : start + _HEAD.size]) if left >= 0 else (0, 0)
            record = Record(opcode, start, start + _HEAD.size, start + _HEAD.size + min(length, max(left, 0)))
            fault = ""
            if left >= 0 and opcode not in allowed:
                fault = f"damaged: a record of number {opcode} is not allowed here"
            elif length <= left or (opcode == Opcode.CHUNK and left >= _CHUNK.size + 16):
                fault = self._declare(source, record, length)
                if not fault:
                    yield record
            if not fault and not 0 <= length <= left:
                fault = f"cut off or damaged: a record of {length} bytes, {max(0, left)} are left"
            if fault:
                yield Damage(start, fault)
                return
            start = record.end

    def _declare(self, source: FileBytes | bytes, record: Record, length: int) -> str:
        """Add what a record of some length declares, if anything; what is wrong if its content is not what it must be."""
        opcode, kind = record.opcode, _PARSED.get(record.opcode)
        if opcode == Opcode.MESSAGE:
            fits = length >= _MESSAGE.size
        elif opcode == Opcode.CHUNK:
            fits = length >= _CHUNK.size + 8 and self._head(record).end == record.start + length
        elif opcode == Opcode.MESSAGE_INDEX:
            fits = length >= 6 and length - 6 == int.from_bytes(source[record.start + 2 : record.start + 6], "little")
        else:
            fits = opcode != Opcode.DATA_END or length == 4
        if not fits:
            return "damaged: the content of a record is not as long as it states"
        if opcode in _EXTRAS:
            self.extras.append(record)
        if kind is None:
            return ""
        stream = ReadDataStream(BytesIO(source[record.start : record.end]))
        try:
            content: Any = kind.read(stream)
            if stream.count != length:
                raise ValueError("extra bytes")
            self._declared(content)
        except (McapError, ValueError, struct.error, EOFError, OverflowError, DatasetError) as err:
            return f"damaged {kind.__name__.lower()}: {described(err)}"
        return ""

    def _declared(self, content: Header | Schema | Channel | Metadata | Statistics) -> None:
        """Keep what was declared; a `DatasetError` if it breaks a rule."""
        if isinstance(content, Schema):
            self.schemas[content.id] = content
        elif isinstance(content, Channel):
            self.channels[content.id] = content
        elif isinstance(content, Metadata):
            self.metadata[content.name] = content.metadata
        elif isinstance(content, Statistics):
            self.statistics = content
        else:
            self.header = content

    def _read_index(self) -> tuple[int, int] | Damage:
        """Return the start and end of the index of a finished file, verified by its checksum if it has one, and declared."""
        data, at = self.data, len(self.data) - len(MAGIC) - _FOOTER.size
        if at < len(MAGIC) or not self.finished:
            return Damage(max(0, len(data) - len(MAGIC)), "cut off or damaged: the file does not end as an MCAP file")
        opcode, _, start, _, crc = _FOOTER.unpack(data[at : at + _FOOTER.size])
        if opcode != Opcode.FOOTER or start > at or (crc and data.crc32(start or at, at + _FOOTER.size - 4) != crc):
            return Damage(at, "damaged: the index at the end does not match its checksum")
        deque(self._records(data, start or at, at, _IN_INDEX), 0)  # it repeats what damaged chunks may have declared
        return start or at, at

    def _fits(self, place: int, start: int, end: int) -> bool:
        """Return whether bytes match the checksum at a place, if there is one."""
        crc = int.from_bytes(self.data[place : place + 4], "little")
        return not crc or crc == self.data.crc32(start, end)

    def _end_damage(self, record: Record, index: tuple[int, int] | Damage) -> Iterator[Damage]:
        """Compare the checksum in the record that ends the data, if there is one, and what follows it."""
        if not self._fits(record.start, 0, record.offset):
            yield Damage(record.offset, "damaged: the bytes before do not match this checksum")
        if isinstance(index, Damage):
            yield index
        elif index[0] != record.end:
            yield Damage(record.end, "damaged: the index does not follow the data")


class McapFile:
    """A new MCAP file, by default of the profile `ros2`; a `FileError` if the path exists or cannot be written. Not thread-safe.

    So do all methods that write; nothing of what they were to write is then in the file.
    """

    def __init__(
        self, path: str | Path, header: Header | None = None, compression: CompressionType = CompressionType.NONE
    ) -> None:
        self.path = Path(path)
        self.types: dict[str, str] = {}  # of the messages, by declared topic
        self.size = 0  # so far [bytes]
        with system_errors(self.path):
            self._fd = os.open(self.path, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_APPEND, 0o644)
        self._parts: list[bytes] = []  # made by the writer, and not in the file yet
        self._schemas: dict[tuple[str, str, bytes], int] = {}
        self._channels: dict[str, int] = {}
        self._failed = False
        end = lambda: self.size + sum(map(len, self._parts))  # noqa: E731
        output: Any = SimpleNamespace(write=self._parts.append, tell=end, flush=lambda: None)
        self._writer: Any = Writer(output, chunk_size=sys.maxsize, compression=compression, enable_data_crcs=True)
        self._writer.start(*(("ros2", LIBRARY) if header is None else (header.profile, header.library)))
        self._commit()

    def declare(self, topic: str, type_name: str, definition: str) -> int:
        """Declare a topic of messages such as `std_msgs/msg/String`, with their definition as `ros2msg`; gives its number."""
        schema = Schema(0, definition.encode(), "ros2msg", type_name)
        self._channels[topic] = self.add_channel(Channel(0, topic, "cdr", {"offered_qos_profiles": ""}, 0), schema)
        self.types[topic] = type_name
        return self._channels[topic]

    def add_channel(self, channel: Channel, schema: Schema | None) -> int:
        """Declare a channel as another file does, with the schema of its messages if it has one; gives its number here."""
        number = 0
        if schema is not None:
            key = schema.name, schema.encoding, schema.data
            number = self._schemas.get(key) or self._schemas.setdefault(key, self._writer.register_schema(*key))
        return int(self._writer.register_channel(channel.topic, channel.message_encoding, number, channel.metadata))

    def message(self, topic: str, data: bytes, log_time_ns: int, sent_ns: int, sequence: int) -> Message:
        """Return a message of a declared topic, to be written; a `DatasetError` if the topic or a time [ns] is invalid.

        Args:
            topic: A declared topic.
            data: The serialised message.
            log_time_ns: When it was received [ns].
            sent_ns: When it was sent [ns].
            sequence: Its number by the publisher.
        """
        if topic not in self._channels:
            raise DatasetError(f"{self.path}: {topic} was not declared by add_topic")
        for name, time_ns in (("log_time_ns", log_time_ns), ("publish_time_ns", sent_ns)):
            if not 0 <= time_ns < 2**63:
                raise DatasetError(f"{name}: {time_ns} is not a time since 1970")
        return Message(self._channels[topic], log_time_ns, data, sent_ns, sequence & 0xFFFFFFFF)

    def write_chunk(self, messages: Sequence[Message]) -> None:
        """Append messages as one chunk: afterwards, either all of it is in the file or nothing."""
        for message in messages:
            self._writer.add_message(
                message.channel_id, message.log_time, message.data, message.publish_time, message.sequence
            )
        self._commit()

    def write_attachment(self, attachment: Attachment) -> None:
        """Append a file of others that belongs to the recording."""
        self._writer.add_attachment(**vars(attachment))
        self._commit()

    def write_metadata(self, name: str, values: dict[str, str]) -> None:
        """Append named texts; of several with the same name the last is valid."""
        self._writer.add_metadata(name, values)
        self._commit()

    @property
    def removed(self) -> bool:
        """Whether the path no longer leads to the open file: it was removed, moved, or its file system unmounted."""
        if self._fd < 0:
            return False
        try:
            status = self.path.stat()
        except OSError:
            return True
        return not os.path.samestat(status, os.fstat(self._fd))

    @property
    def free_bytes(self) -> int:
        """Space on the disk that holds the open file, for this user [bytes]; 0 once it is closed."""
        if self._fd < 0:
            return 0
        with system_errors(self.path):
            space = os.fstatvfs(self._fd)
        return space.f_bavail * space.f_frsize

    def sync(self) -> None:
        """Wait until everything written is on the disk; if this fails, the content of the disk is unknown."""
        with system_errors(self.path, "cannot be synchronised"):
            os.fdatasync(self._fd)

    def finish(self) -> None:
        """Write index and summary and close the file in any case; after a write that failed, it stays without them."""
        try:
            if not self._failed:  # else the writer knows of chunks that are not in the file
                self._writer.finish()
                self._commit()
                self.sync()
        finally:
            self.abandon()

    def abandon(self) -> None:
        """Close the file as it is; may be called more than once."""
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1

    def _commit(self) -> None:
        if self._fd < 0:
            raise FileError(self.path, "is closed")
        self._writer.flush()
        content = b"".join(self._parts)
        self._parts.clear()
        rest = memoryview(content)
        try:
            with system_errors(self.path):
                while rest:
                    rest = rest[os.write(self._fd, rest) :]
        except FileError:
            self._failed = True
            try:
                os.ftruncate(self._fd, self.size)  # remove the remains of the write
            except OSError:
                self.abandon()  # they stay: readers stop before them, and nothing may be written after them
            raise
        self.size += len(content)
