# SPDX-License-Identifier: Apache-2.0
"""An MCAP file that is appended to by whole chunks.

Why not the writer of `mcap`: it may leave half a chunk behind when a disk is full, and cannot go back. Here each
chunk is handed to the system in one piece, and what a failed write left is cut off again, so that the file always
ends where a chunk ends. The layout is that of the MCAP specification, uncompressed: a reader finds a message by
its offset, and one lost byte costs one chunk.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from mcap.records import Channel, ChunkIndex, DataEnd, Header, McapRecord, Metadata, MetadataIndex, Schema

from foretouch.dataset.recording.mcap_index import MAGIC, TIME_END, FileIndex, encode_record, message_index
from foretouch.errors import DatasetError, FileError

__all__ = ["MAGIC", "McapFile", "McapMessage"]

_CHUNK_START = struct.Struct("<BQQQQIIQ")  # opcode, length, start, end, size, crc, no compression, size of the data
_MESSAGE_START = struct.Struct("<BQHIQQ")  # opcode, length, channel, sequence, log time, publish time
_WRITEV_MAX = 1000  # buffers a call; the system takes 1024


@dataclass(frozen=True, eq=False)
class McapMessage:
    """One serialised message.

    Attributes:
        channel: Number that `McapFile.add_channel` gave.
        data: CDR with its encapsulation header.
        log_time_ns: When it was received [ns].
        publish_time_ns: When it was sent [ns].
        sequence: Of the middleware, or a count.
    """

    channel: int
    data: bytes | memoryview
    log_time_ns: int
    publish_time_ns: int
    sequence: int = 0

    def __post_init__(self) -> None:
        for name in ("log_time_ns", "publish_time_ns"):
            if not 0 <= getattr(self, name) < TIME_END:
                raise DatasetError(f"{name}: {getattr(self, name)} is no time since 1970")


class McapFile:
    """A new MCAP file of the profile `ros2`.

    Args:
        path: Must not exist.
        library: What writes it, with its version.

    Raises:
        FileError: If the path exists or cannot be written.
    """

    def __init__(self, path: str | Path, library: str) -> None:
        self.path = Path(path)
        try:
            self._fd = os.open(self.path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o644)
        except OSError as err:
            raise FileError(self.path, _told(err)) from err
        self.size = 0
        self._crc = 0
        self._schemas: dict[str, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._unused: set[int] = set()
        self._index = FileIndex()
        self._commit([MAGIC, encode_record(Header(profile="ros2", library=library))])

    @property
    def message_count(self) -> int:
        """Messages written so far."""
        return self._index.message_count

    def add_channel(self, topic: str, type_name: str, definition: str, qos: str = "") -> int:
        """Declare a topic.

        Schema and channel are written at once, and again in the first chunk that needs them: one copy has a
        checksum of its own, the other is there when that chunk is damaged.

        Args:
            topic: Its name.
            type_name: Such as `std_msgs/msg/String`.
            definition: In the format `ros2msg`.
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
            id=number,
            topic=topic,
            message_encoding="cdr",
            metadata={"offered_qos_profiles": qos},
            schema_id=schema.id,
        )
        self._commit([*([encode_record(schema)] if new else []), encode_record(channel)])
        self._schemas[type_name] = schema
        self._channels[number] = channel
        self._unused.add(number)
        return number

    def write_chunk(self, messages: Sequence[McapMessage]) -> None:
        """Append messages as one chunk: either all of it is in the file afterwards, or none.

        Raises:
            FileError: If the system refuses; the cause is an `OSError` with its number.
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
        index, index_offsets = message_index(offsets, chunk_offset + 9 + length)
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
        """Append named texts; of several with one name the last counts (raises as `write_chunk`)."""
        data = encode_record(Metadata(name=name, metadata=dict(values)))
        index = MetadataIndex(offset=self.size, length=len(data), name=name)
        self._commit([data])
        self._index.add_metadata(index)

    def sync(self) -> None:
        """Have the system put all that was written on the disk.

        Raises:
            FileError: If it cannot; what then lies on the disk is unknown.
        """
        try:
            os.fdatasync(self._fd)
        except OSError as err:
            raise FileError(self.path, f"cannot be synchronised: {_told(err)}") from err

    def finish(self) -> None:
        """Write index and summary and close the file; it is closed in any case.

        Raises:
            FileError: If the system refuses; every chunk is still in the file, without an index.
        """
        try:
            self._commit([encode_record(DataEnd(self._crc))])
            self._commit(self._index.summary(self.size, self._schemas.values(), self._channels.values()))
            self.sync()
        finally:
            self.abandon()

    def abandon(self) -> None:
        """Close the file as it is; more than once does no harm."""
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1

    def _declarations(self, channels: set[int]) -> bytes:
        """The records that must stand before the first message of a channel."""
        fresh = sorted(channels & self._unused)
        schemas = {schema.id: schema for schema in self._schemas.values()}
        needed = sorted({self._channels[number].schema_id for number in fresh})
        records: list[McapRecord] = [schemas[number] for number in needed]
        return b"".join(map(encode_record, [*records, *(self._channels[number] for number in fresh)]))

    def _commit(self, parts: Sequence[bytes | bytearray | memoryview]) -> None:
        """Write all, or leave the file as it was."""
        if self._fd < 0:
            raise FileError(self.path, "is closed")
        total = sum(map(len, parts))
        try:
            _write_all(self._fd, parts, total)
        except OSError as err:
            self._cut()
            raise FileError(self.path, _told(err)) from err
        for part in parts:
            self._crc = zlib.crc32(part, self._crc)
        self.size += total

    def _cut(self) -> None:
        """Remove what a failed write left."""
        try:
            os.ftruncate(self._fd, self.size)
            os.lseek(self._fd, self.size, os.SEEK_SET)
        except OSError:
            self.abandon()  # the remnant stays: readers stop before it, and nothing may be written after it


def _write_all(fd: int, parts: Sequence[bytes | bytearray | memoryview], total: int) -> None:
    views = [memoryview(part) for part in parts if len(part)]
    while total:
        written = os.writev(fd, views[:_WRITEV_MAX])
        total -= written
        while written and written >= len(views[0]):
            written -= len(views.pop(0))
        if written:
            views[0] = views[0][written:]


def _told(err: OSError) -> str:
    return f"{err.strerror or err} (errno {err.errno})"
