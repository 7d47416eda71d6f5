# SPDX-License-Identifier: Apache-2.0
"""Scans the bytes of a recording record by record without trusting any length in it.

The file is mapped into memory, so only requested bytes are copied, and no length in it can make the reader allocate
more memory than the size of the file. A scan ends at an invalid record with its offset, and can continue at the next
chunk with a valid checksum.
"""

import mmap
import os
import re
import struct
import zlib
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any, Final, NamedTuple, TypeAlias, TypeVar

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Header, McapRecord, Metadata, Schema

from foretouch.checked_files import open_regular
from foretouch.dataset.recording.mcap_file import MAGIC
from foretouch.errors import FileError

Declaration: TypeAlias = Schema | Channel | Metadata

_HEAD = struct.Struct("<BQ")
_FOOTER = struct.Struct("<BQQQI")  # opcode, length, start of the summary, of its offsets, checksum
_CHUNK = struct.Struct("<QQQIIQ")  # start, end, size, crc, compression (none), size of the data
_MESSAGE = struct.Struct("<HIQQ")
INDEX_HEAD = struct.Struct("<HI")
_KNOWN: Final = {Opcode.SCHEMA, Opcode.CHANNEL, Opcode.CHUNK, Opcode.METADATA, Opcode.DATA_END, Opcode.FOOTER}
_CHUNK_START: Final = re.compile(rb"\x06(?=.{8}.{24}.{4}\x00{4})", re.DOTALL)
_P = TypeVar("_P", bound=McapRecord)


class Damage(NamedTuple):
    """An invalid part of a file."""

    offset: int  # its position [bytes]
    rule: str  # the rule that it breaks

    def error(self, path: Path) -> FileError:
        """As an error that names file and position."""
        return FileError(path, self.rule, field=f"byte {self.offset}")


class RawRecord(NamedTuple):
    """One record: its opcode, its offset, and the start and end of its body."""

    opcode: int
    offset: int
    start: int
    end: int


class Chunk(NamedTuple):
    """A chunk with consistent sizes: start and end of its data, and their declared checksum."""

    offset: int
    start: int
    end: int
    crc: int

    def intact(self, data: memoryview) -> bool:
        """Whether the data match the checksum."""
        return zlib.crc32(data[self.start : self.end]) == self.crc


class RawMessage(NamedTuple):
    """A message in a chunk: `start` and `end` of its CDR in the file."""

    channel: int
    sequence: int
    log_time_ns: int
    publish_time_ns: int
    start: int
    end: int


@contextmanager
def mapped(path: Path) -> Iterator[memoryview]:
    """The bytes of a file, read from the disk on access.

    Raises:
        FileError: If it cannot be read.
    """
    with ExitStack() as stack:
        try:
            file = stack.enter_context(open_regular(path))
            size = os.fstat(file.fileno()).st_size  # an empty file cannot be mapped
            data = stack.enter_context(mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)) if size else b""
        except OSError as err:
            raise FileError(path, err.strerror or str(err)) from err
        yield stack.enter_context(memoryview(data))


def magic_damage(data: memoryview) -> Damage | None:
    """The fault of the first bytes, if there is one."""
    if len(data) == 0:
        return Damage(0, "is empty")
    return None if bytes(data[: len(MAGIC)]) == MAGIC else Damage(0, "is no MCAP file: it does not begin as one")


def records(data: memoryview, start: int, end: int | None = None) -> Iterator[RawRecord | Damage]:
    """The records from offset `start` to `end`, by default the end of the file; ends after a `Damage` or the footer."""
    end = len(data) if end is None else end
    while start < end:
        if end - start < _HEAD.size:
            yield Damage(start, f"cut off: {end - start} bytes are no record")
            return
        opcode, length = _HEAD.unpack_from(data, start)
        if length > end - start - _HEAD.size:
            left = end - start - _HEAD.size
            yield Damage(start, f"cut off or damaged: a record of {length} bytes, {left} are left")
            return
        if opcode == 0:
            yield Damage(start, "damaged: no record has the number 0")
            return
        record = RawRecord(opcode, start, start + _HEAD.size, start + _HEAD.size + length)
        yield record
        if opcode == Opcode.FOOTER:
            return
        start = record.end


def chunk_at(data: memoryview, record: RawRecord) -> Chunk | Damage:
    """The chunk in a record; foretouch writes them uncompressed."""
    if record.end - record.start < _CHUNK.size:
        return Damage(record.offset, "damaged: a chunk too short for its head")
    _, _, size, crc, compression, data_size = _CHUNK.unpack_from(data, record.start)
    if compression:
        return Damage(record.offset, "damaged, or compressed, which foretouch does not support")
    if not size == data_size == record.end - record.start - _CHUNK.size:
        return Damage(record.offset, "damaged: the sizes of a chunk do not add up")
    return Chunk(record.offset, record.start + _CHUNK.size, record.end, crc)


def next_chunk(data: memoryview, start: int) -> Chunk | None:
    """The first chunk with a valid checksum at any offset from `start` on; None if there is none."""
    for match in _CHUNK_START.finditer(data, start):
        found = next(records(data, match.start()))
        if isinstance(found, RawRecord):
            chunk = chunk_at(data, found)
            if isinstance(chunk, Chunk) and chunk.intact(data):
                return chunk
    return None


def messages_of(data: memoryview, start: int, end: int) -> Iterator[RawMessage | RawRecord | Damage]:
    """The contents of a chunk's data: messages, and the records of schemas and channels."""
    for record in records(data, start, end):
        if isinstance(record, Damage) or record.opcode != Opcode.MESSAGE:
            yield record
        elif record.end - record.start < _MESSAGE.size:
            yield Damage(record.offset, "damaged: a message too short for its head")
        else:
            channel, sequence, log_time, publish_time = _MESSAGE.unpack_from(data, record.start)
            yield RawMessage(channel, sequence, log_time, publish_time, record.start + _MESSAGE.size, record.end)


def parse(kind: type[_P], data: memoryview, record: RawRecord) -> _P | Damage:
    """The content of a record."""
    stream = ReadDataStream(BytesIO(data[record.start : record.end]))
    reader: Any = kind
    try:
        content: _P = reader.read(stream)
    except (McapError, ValueError, struct.error, EOFError, OverflowError) as err:
        return Damage(
            record.offset, f"damaged: no {kind.__name__.lower()}: {' '.join(str(err).split()) or type(err).__name__}"
        )
    if stream.count != record.end - record.start:
        return Damage(record.offset, f"damaged: extra bytes after a {kind.__name__.lower()}")
    return content


def declaration(data: memoryview, record: RawRecord) -> Declaration | Damage | None:
    """The schema, channel or metadata in a record; None for other records."""
    if record.opcode == Opcode.SCHEMA:
        return parse(Schema, data, record)
    if record.opcode == Opcode.CHANNEL:
        return parse(Channel, data, record)
    return parse(Metadata, data, record) if record.opcode == Opcode.METADATA else None


def summary_of(data: memoryview) -> tuple[int, int] | Damage:
    """Start and end of the summary of a finished file, verified by its checksum."""
    at = len(data) - len(MAGIC) - _FOOTER.size
    if at < len(MAGIC):
        return Damage(0, "damaged: too short for a finished recording")
    opcode, length, start, _, crc = _FOOTER.unpack_from(data, at)
    if opcode != Opcode.FOOTER or length != _FOOTER.size - _HEAD.size or not len(MAGIC) <= start <= at:
        return Damage(at, "damaged: the footer of a finished recording is no footer")
    if zlib.crc32(data[start : at + _FOOTER.size - 4]) != crc:
        return Damage(start, "damaged: the index at the end does not match its checksum")
    return start, at


def check_record(data: memoryview, record: RawRecord) -> Damage | None:
    """Check the length of a record without checksum against its content: a wrong one would skip valid records."""
    content: object = None
    if record.opcode == Opcode.HEADER:
        content = parse(Header, data, record)
    elif record.opcode == Opcode.MESSAGE_INDEX:
        size = record.end - record.start - INDEX_HEAD.size
        if size < 0 or size % 16 or size != INDEX_HEAD.unpack_from(data, record.start)[1]:
            content = Damage(record.offset, "damaged: the sizes of an index do not add up")
    elif record.opcode not in _KNOWN:
        content = Damage(record.offset, f"damaged: a record of number {record.opcode} is not allowed here")
    else:
        content = declaration(data, record)
    return content if isinstance(content, Damage) else None
