# SPDX-License-Identifier: Apache-2.0
"""What leads a reader of an MCAP file to its messages: the index behind each chunk, and the summary at the end."""

from __future__ import annotations

import struct
import zlib
from collections import Counter
from collections.abc import Collection, Iterable, Mapping
from typing import Any, Final

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    ChunkIndex,
    Footer,
    McapRecord,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

__all__ = ["MAGIC", "TIME_END", "FileIndex", "encode_record", "message_index"]

MAGIC: Final = b"\x89MCAP0\r\n"
TIME_END: Final = 2**63
_INDEX_START = struct.Struct("<BQHI")
_INDEX_ENTRY = struct.Struct("<QQ")


class FileIndex:
    """What the summary of a file will tell, collected while it is written."""

    def __init__(self) -> None:
        self._counts: Counter[int] = Counter()
        self._chunks = bytearray()
        self._chunk_count = 0
        self._metadata: list[MetadataIndex] = []
        self._times = (TIME_END, 0)

    @property
    def message_count(self) -> int:
        """Messages in all chunks."""
        return self._counts.total()

    def add_chunk(self, index: ChunkIndex, channels: Iterable[int]) -> None:
        """A chunk was written, with a message of each of these channels in turn."""
        self._counts.update(channels)
        self._times = (min(index.message_start_time, self._times[0]), max(index.message_end_time, self._times[1]))
        self._chunk_count += 1
        self._chunks += encode_record(index)

    def add_metadata(self, index: MetadataIndex) -> None:
        """Named texts were written."""
        self._metadata.append(index)

    def summary(self, start: int, schemas: Collection[Schema], channels: Collection[Channel]) -> list[bytes]:
        """The bytes from `start` to the end of the file, the last magic included."""
        groups = [
            (Opcode.SCHEMA, b"".join(map(encode_record, schemas))),
            (Opcode.CHANNEL, b"".join(map(encode_record, channels))),
            (Opcode.STATISTICS, encode_record(self._statistics(len(schemas), len(channels)))),
            (Opcode.CHUNK_INDEX, bytes(self._chunks)),
            (Opcode.METADATA_INDEX, b"".join(map(encode_record, self._metadata))),
        ]
        at = start
        offsets = []
        for opcode, data in groups:
            if data:
                offsets.append(
                    encode_record(SummaryOffset(group_opcode=opcode, group_start=at, group_length=len(data)))
                )
            at += len(data)
        body = b"".join([*(data for _, data in groups), *offsets])
        footer = encode_record(Footer(summary_start=start, summary_offset_start=at, summary_crc=0))[:-4]
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
            metadata_count=len(self._metadata),
            schema_count=schemas,
        )


def message_index(offsets: Mapping[int, list[tuple[int, int]]], start: int) -> tuple[bytes, dict[int, int]]:
    """The index records of one chunk, and where each begins.

    Args:
        offsets: By channel, time and place in the chunk of each message.
        start: Where the first record will stand in the file.
    """
    data = bytearray()
    places = {}
    for channel, entries in offsets.items():
        places[channel] = start + len(data)
        size = len(entries) * _INDEX_ENTRY.size
        data += _INDEX_START.pack(7, 6 + size, channel, size)
        for entry in entries:
            data += _INDEX_ENTRY.pack(*entry)
    return bytes(data), places


def encode_record(record: McapRecord) -> bytes:
    """A record with its opcode and length."""
    builder: Any = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())
