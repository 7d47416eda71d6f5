# SPDX-License-Identifier: Apache-2.0
"""An MCAP file to which complete chunks are appended.

Why not the writer of `mcap`: it may leave half a chunk behind when a disk is full, and cannot remove it. Here each
chunk is passed to the system in one call, and the remains of a failed write are cut off again, so that the file always
ends where a chunk ends. The layout follows the MCAP specification, uncompressed: a reader finds a message by
its offset, and one damaged byte costs one chunk.
"""

import os
import struct
import zlib
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, Final

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from foretouch.dataset.disk import disk_errors
from foretouch.errors import DatasetError, FileError

MAGIC: Final = b"\x89MCAP0\r\n"
_TIME_END: Final = 2**63
_INDEX_START = struct.Struct("<BQHI")  # opcode, length, channel, size of the entries
_INDEX_ENTRY = struct.Struct("<QQ")  # time, offset
_CHUNK_START = struct.Struct("<BQQQQIIQ")  # opcode, length, start, end, size, crc, no compression, size of the data
_MESSAGE_START = struct.Struct("<BQHIQQ")  # opcode, length, channel, sequence, log time, publish time
_WRITEV_MAX = 1000  # buffers a call; the system accepts 1024


@dataclass(frozen=True, eq=False)
class McapMessage:
    """One serialised message."""

    channel: int  # the number returned by `McapFile.add_channel`
    data: bytes | memoryview  # CDR with its encapsulation header
    log_time_ns: int  # when it was received [ns]
    publish_time_ns: int  # when it was sent [ns]
    sequence: int = 0  # sequence number of the middleware, or a count

    def __post_init__(self) -> None:
        for name in ("log_time_ns", "publish_time_ns"):
            if not 0 <= getattr(self, name) < _TIME_END:
                raise DatasetError(f"{name}: {getattr(self, name)} is no time since 1970")


class McapFile:
    """A new MCAP file of the profile `ros2`.

    Args:
        path: Must not exist.
        library: Name and version of the writing program.

    Raises:
        FileError: If the path exists or cannot be written.
    """

    def __init__(self, path: str | Path, library: str) -> None:
        self.path = Path(path)
        with disk_errors(self.path):
            self._fd = os.open(self.path, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o644)
        self.size = 0
        self._crc = 0
        self._schemas: dict[str, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._unused: set[int] = set()
        self._index = _FileIndex()
        self._commit([MAGIC, _encode(Header(profile="ros2", library=library))])

    @property
    def message_count(self) -> int:
        """Messages written so far."""
        return self._index.message_count

    def add_channel(self, topic: str, type_name: str, definition: str, qos: str = "") -> int:
        """Declare a topic.

        Schema and channel are written immediately, and again in the first chunk that needs them: the copy in the chunk
        has a checksum, the other remains if that chunk is damaged.

        Args:
            topic: Its name.
            type_name: Such as `std_msgs/msg/String`.
            definition: The message definition in the format `ros2msg`.
            qos: The offered QoS profiles as rosbag2 writes them, YAML.

        Returns:
            The number of the channel.
        """
        schema = self._schemas.get(type_name)
        new = schema is None
        if schema is None:
            schema = Schema(id=len(self._schemas) + 1, data=definition.encode(), encoding="ros2msg", name=type_name)
        number = len(self._channels) + 1
        channel = Channel(
            id=number, topic=topic, message_encoding="cdr", metadata={"offered_qos_profiles": qos}, schema_id=schema.id
        )
        self._commit([*([_encode(schema)] if new else []), _encode(channel)])
        self._schemas[type_name] = schema
        self._channels[number] = channel
        self._unused.add(number)
        return number

    def write_chunk(self, messages: Sequence[McapMessage]) -> None:
        """Append messages as one chunk: afterwards, either all of it is in the file or nothing.

        Raises:
            FileError: If the write fails; the cause is an `OSError` with its number.
        """
        if not messages:
            return
        head = self._declarations({message.channel for message in messages})
        parts: list[bytes | memoryview] = [head]
        offsets: dict[int, list[tuple[int, int]]] = {}
        size = len(head)
        for m in messages:
            offsets.setdefault(m.channel, []).append((m.log_time_ns, size))
            length = _MESSAGE_START.size - 9 + len(m.data)
            sequence = m.sequence & 0xFFFFFFFF
            parts += [_MESSAGE_START.pack(5, length, m.channel, sequence, m.log_time_ns, m.publish_time_ns), m.data]
            size += 9 + length
        crc = 0
        for part in parts:
            crc = zlib.crc32(part, crc)
        times = [message.log_time_ns for message in messages]
        start, end = min(times), max(times)
        length = _CHUNK_START.size - 9 + size
        chunk_offset = self.size
        index, index_offsets = _message_index(offsets, chunk_offset + 9 + length)
        self._commit([_CHUNK_START.pack(6, length, start, end, size, crc, 0, size), *parts, index])
        self._unused -= offsets.keys()
        self._index.add_chunk(
            ChunkIndex(
                message_start_time=start,
                message_end_time=end,
                chunk_start_offset=chunk_offset,
                chunk_length=9 + length,
                message_index_offsets=index_offsets,
                message_index_length=len(index),
                compression="",
                compressed_size=size,
                uncompressed_size=size,
            ),
            (message.channel for message in messages),
        )

    def write_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Append named texts; of several with the same name the last is valid (raises as `write_chunk`)."""
        data = _encode(Metadata(name=name, metadata=dict(values)))
        index = MetadataIndex(offset=self.size, length=len(data), name=name)
        self._commit([data])
        self._index.metadata.append(index)

    @property
    def removed(self) -> bool:
        """Whether the path no longer leads to the open file: it was removed, moved, or its file system unmounted."""
        if self._fd < 0:
            return False
        try:
            found = self.path.stat()
        except OSError:
            return True
        return not os.path.samestat(found, os.fstat(self._fd))

    @property
    def free_bytes(self) -> int:
        """Space on the disk that holds the open file, for this user [bytes]; 0 once it is closed."""
        if self._fd < 0:
            return 0
        with disk_errors(self.path):
            space = os.fstatvfs(self._fd)
        return space.f_bavail * space.f_frsize

    def reopen(self) -> BinaryIO:
        """The open file to be read from its start, even if it was removed; readable after `finish`.

        Raises:
            FileError: If it is closed.
        """
        if self._fd < 0:
            raise FileError(self.path, "is closed")
        with disk_errors(self.path):
            return os.fdopen(os.dup(self._fd), "rb")

    def sync(self) -> None:
        """Wait until everything written is on the disk.

        Raises:
            FileError: If this fails; the content of the disk is then unknown.
        """
        with disk_errors(self.path, "cannot be synchronised"):
            os.fdatasync(self._fd)

    def finish(self) -> None:
        """Write index and summary and close the file; it is closed in any case.

        Raises:
            FileError: If the write fails; every chunk is still in the file, without an index.
        """
        try:
            self._commit([_encode(DataEnd(self._crc))])
            self._commit(self._index.summary(self.size, self._schemas.values(), self._channels.values()))
            self.sync()
        finally:
            self.abandon()

    def abandon(self) -> None:
        """Close the file as it is; may be called more than once."""
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1

    def _declarations(self, channels: set[int]) -> bytes:
        """The records that must precede the first message of a channel."""
        fresh = sorted(channels & self._unused)
        schemas = {schema.id: schema for schema in self._schemas.values()}
        needed = sorted({self._channels[number].schema_id for number in fresh})
        records: list[McapRecord] = [schemas[number] for number in needed]
        return b"".join(map(_encode, [*records, *(self._channels[number] for number in fresh)]))

    def _commit(self, parts: Sequence[bytes | bytearray | memoryview]) -> None:
        """Write everything, or leave the file unchanged."""
        if self._fd < 0:
            raise FileError(self.path, "is closed")
        total = sum(map(len, parts))
        with disk_errors(self.path):
            try:
                _write_all(self._fd, parts, total)
            except OSError:
                self._cut()
                raise
        for part in parts:
            self._crc = zlib.crc32(part, self._crc)
        self.size += total

    def _cut(self) -> None:
        """Remove the remains of a failed write."""
        try:
            os.ftruncate(self._fd, self.size)
            os.lseek(self._fd, self.size, os.SEEK_SET)
        except OSError:
            self.abandon()  # the remains stay: readers stop before them, and nothing may be written after them


def _write_all(fd: int, parts: Sequence[bytes | bytearray | memoryview], total: int) -> None:
    views = [memoryview(part) for part in parts if len(part)]
    while total:
        written = os.writev(fd, views[:_WRITEV_MAX])
        total -= written
        while written and written >= len(views[0]):
            written -= len(views.pop(0))
        if written:
            views[0] = views[0][written:]


class _FileIndex:
    """The contents of a file's summary, collected while the file is written."""

    def __init__(self) -> None:
        self._counts: Counter[int] = Counter()
        self._chunks = bytearray()
        self._chunk_count = 0
        self.metadata: list[MetadataIndex] = []
        self._times = (_TIME_END, 0)

    @property
    def message_count(self) -> int:
        """Messages in all chunks."""
        return self._counts.total()

    def add_chunk(self, index: ChunkIndex, channels: Iterable[int]) -> None:
        """Add a chunk, whose messages are of these channels."""
        self._counts.update(channels)
        self._times = (min(index.message_start_time, self._times[0]), max(index.message_end_time, self._times[1]))
        self._chunk_count += 1
        self._chunks += _encode(index)

    def summary(self, start: int, schemas: Collection[Schema], channels: Collection[Channel]) -> list[bytes]:
        """The bytes from offset `start` to the end of the file, including the final magic."""
        groups = [
            (Opcode.SCHEMA, b"".join(map(_encode, schemas))),
            (Opcode.CHANNEL, b"".join(map(_encode, channels))),
            (Opcode.STATISTICS, _encode(self._statistics(len(schemas), len(channels)))),
            (Opcode.CHUNK_INDEX, bytes(self._chunks)),
            (Opcode.METADATA_INDEX, b"".join(map(_encode, self.metadata))),
        ]
        at = start
        offsets = []
        for opcode, data in groups:
            if data:
                offsets.append(_encode(SummaryOffset(group_opcode=opcode, group_start=at, group_length=len(data))))
            at += len(data)
        body = b"".join([*(data for _, data in groups), *offsets])
        footer = _encode(Footer(summary_start=start, summary_offset_start=at, summary_crc=0))[:-4]
        crc = zlib.crc32(footer, zlib.crc32(body))
        return [body, footer, struct.pack("<I", crc), MAGIC]

    def _statistics(self, schemas: int, channels: int) -> Statistics:
        first, last = self._times
        return Statistics(
            attachment_count=0,
            channel_count=channels,
            channel_message_counts=dict(self._counts),
            chunk_count=self._chunk_count,
            message_count=self.message_count,
            message_end_time=last,
            message_start_time=first if self.message_count else 0,
            metadata_count=len(self.metadata),
            schema_count=schemas,
        )


def _message_index(offsets: Mapping[int, list[tuple[int, int]]], start: int) -> tuple[bytes, dict[int, int]]:
    """The index records of one chunk, and the offset of each in the file.

    Args:
        offsets: By channel, time [ns] and offset in the chunk of each message.
        start: Offset of the first record in the file.
    """
    data = bytearray()
    positions = {}
    for channel, entries in offsets.items():
        positions[channel] = start + len(data)
        size = len(entries) * _INDEX_ENTRY.size
        data += _INDEX_START.pack(7, 6 + size, channel, size)
        for entry in entries:
            data += _INDEX_ENTRY.pack(*entry)
    return bytes(data), positions


def _encode(record: McapRecord) -> bytes:
    """A record with its opcode and length."""
    builder: Any = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())
