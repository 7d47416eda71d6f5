# SPDX-License-Identifier: Apache-2.0
"""Finds the samples in the files of a recorded dataset, and what can be saved of damaged ones, without reading all of them."""

from collections.abc import Iterator
from pathlib import Path
from typing import TypeVar

from mcap.opcode import Opcode

from foretouch.dataset.recording.folder import session_files
from foretouch.dataset.recording.records import (
    IN_CHUNK,
    MAGIC,
    Damage,
    Declarations,
    Record,
    RecordedMessage,
    contents,
    declared_samples,
    is_finished,
    magic_damage,
    walk,
)
from foretouch.dataset.recording.sample_codec import HEAD_SIZE, SAMPLE_TYPES, StoredSample, decode_sample, id_in
from foretouch.errors import DatasetError, FileError, VersionError
from foretouch.files import FileBytes

_T = TypeVar("_T")


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
