# SPDX-License-Identifier: Apache-2.0
"""Finds the intact parts of a damaged recording: chunks by their checksums, samples and declarations by their own."""

import re
from collections.abc import Iterator

from mcap.opcode import Opcode
from mcap.records import Channel, Metadata, Schema

from foretouch.dataset.recording import scan
from foretouch.dataset.recording.mcap_file import MAGIC
from foretouch.dataset.recording.message_counts import MessageCounts
from foretouch.dataset.recording.messages import ABOUT, COUNTS, decode_sample, is_intact
from foretouch.errors import DatasetError

_HEAD = 31  # bytes of a message record before its CDR
_MESSAGE_START = re.compile(rb"\x05(?=.{4}\x00{4})", re.DOTALL)


def intact_parts(data: memoryview, start: int = len(MAGIC)) -> Iterator[scan.Chunk | scan.RawRecord | scan.Damage]:
    """The chunks and records found from offset `start` on, in order; a `Damage` stands for skipped bytes."""
    while start < len(data):
        for record in scan.records(data, start):
            start = record.offset
            if isinstance(record, scan.Damage):
                yield record
                break
            if record.opcode in (Opcode.DATA_END, Opcode.FOOTER):
                return
            chunk = record.opcode == Opcode.CHUNK
            item = scan.chunk_at(data, record) if chunk else scan.check_record(data, record) or record
            if isinstance(item, scan.Damage):
                yield item
                break
            yield item
            start = record.end
        else:
            return
        following = scan.next_chunk(data, start + 1)
        start = len(data) if following is None else following.offset


class Declarations:
    """Schemas, channels and metadata of a file, from any intact copy of them.

    Attributes:
        schemas: By number.
        channels: By number.
        about: Versions, hand and camera, as text.
        counts: The last readable message counts.
    """

    def __init__(self, data: memoryview) -> None:
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}
        self.about: dict[str, str] = {}
        self.counts = MessageCounts()
        verified: list[Schema | Channel] = []
        for item in intact_parts(data):
            if isinstance(item, scan.RawRecord):
                self._add(scan.declaration(data, item))
            elif isinstance(item, scan.Chunk) and item.intact(data):
                inside = scan.messages_of(data, item.start, item.end)
                contents = (scan.declaration(data, record) for record in inside if isinstance(record, scan.RawRecord))
                verified += [content for content in contents if isinstance(content, (Schema, Channel))]
        for content in verified:  # copies under a checksum replace the others
            self._add(content)

    def _add(self, content: scan.Declaration | scan.Damage | None) -> None:
        if isinstance(content, Schema):
            self.schemas[content.id] = content
        elif isinstance(content, Channel):
            self.channels[content.id] = content
        elif isinstance(content, Metadata) and content.name == ABOUT:
            self.about = content.metadata
        elif isinstance(content, Metadata) and content.name == COUNTS:
            try:
                self.counts = MessageCounts.from_mapping(content.metadata)
            except DatasetError:
                return  # keep the previous ones


def samples_after_damage(data: memoryview, start: int) -> Iterator[memoryview]:
    """The intact samples from an invalid record on."""
    for item in intact_parts(data, start):
        if isinstance(item, scan.Damage):
            following = scan.next_chunk(data, item.offset + 1)
            yield from samples_in(data, item.offset, len(data) if following is None else following.offset)
        elif isinstance(item, scan.Chunk) and not item.intact(data):
            yield from samples_in(data, item.start, item.end)
        elif isinstance(item, scan.Chunk):
            inside = scan.messages_of(data, item.start, item.end)
            found = (data[one.start : one.end] for one in inside if isinstance(one, scan.RawMessage))
            yield from filter(is_readable, found)


def samples_in(data: memoryview, start: int, end: int) -> Iterator[memoryview]:
    """The intact samples between two offsets, even if the records around them are damaged."""
    at = start
    for head, stop in _message_heads(data, start, end):
        if head < at:
            continue
        for last in sorted({stop, end}):
            cdr = data[head + _HEAD : last]
            if last <= end and is_readable(cdr):
                yield cdr
                at = last
                break


def _message_heads(data: memoryview, start: int, end: int) -> list[tuple[int, int]]:
    """Possible start and end offsets of messages: from the records before the damage, and from byte patterns."""
    heads: dict[int, int] = {}
    for match in _MESSAGE_START.finditer(data, start, end):
        length = int.from_bytes(data[match.start() + 1 : match.start() + 9], "little")
        heads[match.start()] = match.start() + 9 + length
    for record in scan.records(data, start, end):
        heads[record.offset] = end if isinstance(record, scan.Damage) else record.end
    return sorted(heads.items())


def is_readable(cdr: memoryview) -> bool:
    """Whether the bytes are a complete sample."""
    if not is_intact(cdr):
        return False
    try:
        decode_sample(bytes(cdr))
    except DatasetError:
        return False
    return True
