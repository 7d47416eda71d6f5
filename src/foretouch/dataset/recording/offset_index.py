# SPDX-License-Identifier: Apache-2.0
"""Where the samples of a recording lie, found without decoding anything else.

A chunk's index tells which channels are in it, so the chunks of other messages are passed over unread. A recording
that was cut off gives what is whole up to there.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple, TypeVar

from mcap.opcode import Opcode
from mcap.records import Channel, Schema

from foretouch.dataset.recording.mcap_file import MAGIC
from foretouch.dataset.recording.messages import SAMPLE_TYPE, decode_sample
from foretouch.dataset.recording.recovery import samples_beyond
from foretouch.dataset.recording.scan import (
    INDEX_HEAD,
    Chunk,
    Damage,
    Declaration,
    RawMessage,
    RawRecord,
    check_record,
    chunk_at,
    declaration,
    magic_damage,
    mapped,
    messages_of,
    records,
)
from foretouch.errors import FileError

__all__ = ["Place", "sample_ids", "sample_places"]

_T = TypeVar("_T")


class Place(NamedTuple):
    """Where the CDR of a sample lies in its file."""

    start: int
    end: int
    log_time_ns: int


def sample_places(path: Path, data: memoryview) -> Iterator[Place]:
    """The samples of a file in order, up to its end or to where it is cut off.

    Args:
        path: For messages.
        data: The file.

    Raises:
        FileError: At the first record that cannot be right, unless the file just ends within it.
    """
    schemas: set[int] = set()
    channels: set[int] = set()
    damage = magic_damage(data)
    if damage is not None and len(data) >= len(MAGIC):
        raise damage.error(path)
    waiting: Chunk | None = None
    indexed: set[int] = set()  # channels of the chunk that waits, as the index behind it tells
    for record in records(data, len(MAGIC)):
        if isinstance(record, RawRecord) and record.opcode == Opcode.MESSAGE_INDEX:
            _require(path, check_record(data, record))
            indexed.add(INDEX_HEAD.unpack_from(data, record.start)[0])
            continue
        if waiting is not None and (not indexed or indexed & channels or isinstance(record, Damage)):
            yield from _samples_of(path, data, waiting, channels)
        waiting, indexed = None, set()
        if isinstance(record, Damage):
            if record.rule.startswith("cut off"):
                return
            raise record.error(path)
        if record.opcode == Opcode.DATA_END:
            return
        if record.opcode == Opcode.CHUNK:
            waiting = _require(path, chunk_at(data, record))
        else:
            _require(path, check_record(data, record))
            _declare(path, declaration(data, record), schemas, channels)
    if waiting is not None:
        yield from _samples_of(path, data, waiting, channels)


def sample_ids(path: Path) -> list[str]:
    """The ids in a file, and behind where it seems cut off those that `repair` would save (raises as `sample_places`)."""
    with mapped(path) as data:
        ids = [_id_of(path, data, place) for place in sample_places(path, data)]
        cut = next((one.offset for one in records(data, len(MAGIC)) if isinstance(one, Damage)), len(data))
        return ids + [decode_sample(bytes(cdr)).record.sample.id for cdr in samples_beyond(data, cut)]


def _require(path: Path, found: _T | Damage) -> _T:
    """What was found, unless it is damage."""
    if isinstance(found, Damage):
        raise found.error(path)
    return found


def _samples_of(path: Path, data: memoryview, chunk: Chunk, channels: set[int]) -> Iterator[Place]:
    for message in messages_of(data, chunk.start, chunk.end):
        if isinstance(message, Damage):
            raise message.error(path)
        if isinstance(message, RawMessage) and message.channel in channels:
            yield Place(message.start, message.end, message.log_time_ns)


def _declare(path: Path, content: Declaration | Damage | None, schemas: set[int], channels: set[int]) -> None:
    """Learn which channels hold the samples."""
    if isinstance(content, Damage):
        raise content.error(path)
    if isinstance(content, Schema) and content.name == SAMPLE_TYPE:
        schemas.add(content.id)
    if isinstance(content, Channel) and content.schema_id in schemas:
        channels.add(content.id)


def _id_of(path: Path, data: memoryview, place: Place) -> str:
    """The id in a serialised sample: behind the header (stamp, frame) and the schema version."""
    try:
        at = place.start + 4  # the encapsulation, from which CDR aligns
        (frame,) = struct.unpack_from("<I", data, at + 8)
        offset = 12 + frame
        offset += -offset % 2 + 2  # the schema version
        offset += -offset % 4
        (length,) = struct.unpack_from("<I", data, at + offset)
        begin = at + offset + 4
        if begin + length > place.end:
            raise ValueError("an id longer than its message")
        return bytes(data[begin : begin + length]).rstrip(b"\0").decode()
    except (struct.error, ValueError) as err:
        raise FileError(
            path, f"damaged: the id of a sample cannot be read: {err}", field=f"byte {place.start}"
        ) from err
