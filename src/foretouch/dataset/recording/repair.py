# SPDX-License-Identifier: Apache-2.0
"""Repairs an unfinished or damaged recording, and keeps the original.

Everything that can be verified is kept: every chunk with a valid checksum, and every sample with a valid checksum in a
damaged part. Losses are reported with their offsets. The repaired file replaces the original in one step, and the
original is kept beside it as `<name>.before-repair`.
"""

import os
import re
from collections import Counter
from collections.abc import Iterator
from contextlib import nullcontext
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path
from typing import Final

from mcap.records import Message

from foretouch.dataset.disk import disk_errors, sync_folder
from foretouch.dataset.recording.definitions import Definitions
from foretouch.dataset.recording.folder import lock, recorded_files
from foretouch.dataset.recording.mcap_file import LIBRARY, McapFile
from foretouch.dataset.recording.message_counts import MessageCounts, TopicCounts
from foretouch.dataset.recording.records import (
    IN_CHUNK,
    IN_SUMMARY,
    MAGIC,
    Chunk,
    Damage,
    Declarations,
    Record,
    RecordedMessage,
    mapped,
    next_chunk,
    summary_of,
    walk,
    walk_on,
)
from foretouch.dataset.recording.sample_codec import ABOUT, COUNTS, SAMPLE_TOPIC, SAMPLE_TYPE, decode_sample, is_intact
from foretouch.dataset.recording.verify import verify_file
from foretouch.errors import DatasetError, FileError, VersionError

_KEPT: Final = ".before-repair"
_LOST: Final = "lost before repair"
_HEAD: Final = 31  # bytes of a message record before its CDR
_MESSAGE_START: Final = re.compile(rb"\x05(?=.{4}\x00{4})", re.DOTALL)


@dataclass(eq=False)
class RepairReport:
    """The repair of one file."""

    path: Path  # the file
    changed: bool = False  # whether it needed a repair
    samples: int = 0  # samples in it now
    messages: int = 0  # messages in it now, including samples
    original: Path | None = None  # the file that keeps the original, or None
    lost: list[Damage] = field(default_factory=list)  # the parts that were not kept, with their offsets in the original


def repair_dataset(path: str | Path) -> list[RepairReport]:
    """Repair every recording of a dataset that needs it, or a single file.

    Raises:
        FileError: If another process records into the dataset, it is no recording or of another version, or the disk has
            no space for the repaired file.
    """
    path = Path(path)
    recorded_files(path)  # refuses other folders, before a lock file is created there
    with lock(path) if path.is_dir() else nullcontext():
        return [_repair_file(file) for file in recorded_files(path)]


def _repair_file(path: Path) -> RepairReport:
    """Repair one recording; a clean one is not changed."""
    found = verify_file(path)
    report = RepairReport(path, samples=len(found.ids), messages=found.messages.total())
    if found.clean:
        return report
    report.changed = True
    part = path.with_name(f"{path.name}.repairing")
    part.unlink(missing_ok=True)
    try:
        with mapped(path) as data:
            if not MAGIC.startswith(bytes(data[: len(MAGIC)])) and next_chunk(data, 0) == len(data):
                raise FileError(path, "is no MCAP file, and holds no part of one")
            _Repair(data, McapFile(part), report).run()
        report.original = _replace(path, part)
    except VersionError as err:
        raise FileError(path, str(err)) from err
    finally:
        part.unlink(missing_ok=True)
    return report


def _replace(path: Path, repaired: Path) -> Path:
    """Replace the original by the repaired file; the original gets its second name before it loses the first."""
    names = (f"{path.name}{_KEPT}{'' if number == 1 else f'-{number}'}" for number in count(1))
    kept = next(path.with_name(name) for name in names if not path.with_name(name).exists())
    with disk_errors(path, "cannot be replaced"):
        try:
            os.link(path, kept)
        except OSError:
            path.rename(kept)  # a file system without links: for a moment no file has the original's name
        repaired.replace(path)
        sync_folder(path.parent)
    return kept


class _Repair:
    """Copies the intact parts of a file into a new one."""

    def __init__(self, data: memoryview, file: McapFile, report: RepairReport) -> None:
        self._data = data
        self._file = file
        self._report = report
        self._declared = _declarations(data)
        self._written: Counter[str] = Counter()
        self._topics: dict[int, str] = {}  # by the channel of the original

    def run(self) -> None:
        try:
            about = {**self._declared.about, "repaired_by": LIBRARY}
            self._declare()
            self._file.write_metadata(ABOUT, about)
            for item in walk_on(self._data):
                self._add(item)
            self._report.messages = self._file.message_count
            self._report.samples = self._written[SAMPLE_TOPIC]
            self._file.write_metadata(COUNTS, self._counts().to_mapping())
            self._file.finish()
        finally:
            self._file.abandon()

    def _declare(self) -> None:
        definition = Definitions().text(SAMPLE_TYPE)  # the file's own copy may be damaged
        self._file.declare(SAMPLE_TOPIC, SAMPLE_TYPE, definition)
        for number, channel in sorted(self._declared.channels.items()):
            schema = self._declared.schemas.get(channel.schema_id)
            if schema is None or channel.message_encoding != "cdr" or schema.encoding != "ros2msg":
                continue
            self._topics[number] = channel.topic
            if channel.topic not in self._file.types:
                qos = channel.metadata.get("offered_qos_profiles", "")
                self._file.declare(channel.topic, schema.name, schema.data.decode("utf-8", "replace"), qos)

    def _add(self, item: Record | Damage) -> None:
        if isinstance(item, Damage):
            self._report.lost.append(item)
            self._recover(item.offset, next_chunk(self._data, item.offset + 1))
        elif isinstance(item.content, Chunk) and item.content.intact(self._data):
            self._copy(item.content)
        elif isinstance(item.content, Chunk):
            self._report.lost.append(Damage(item.offset, "damaged: a chunk that does not match its checksum"))
            self._recover(item.content.start, item.content.end)

    def _copy(self, chunk: Chunk) -> None:
        kept: list[tuple[str, Message]] = []
        for item in walk(self._data, chunk.start, chunk.end, IN_CHUNK):
            if isinstance(item, Damage):
                self._report.lost.append(item)
            elif isinstance(one := item.content, RecordedMessage):
                cdr = self._data[one.start : one.end]
                topic = self._topics.get(one.channel, SAMPLE_TOPIC)
                if topic == SAMPLE_TOPIC and not _is_readable(cdr):
                    rule = "a message whose declaration or content is damaged"
                    self._report.lost.append(Damage(one.start, rule))
                    continue
                times = one.log_time_ns, one.publish_time_ns
                kept.append((topic, self._file.message(topic, bytes(cdr), *times, one.sequence)))
        self._write(kept)

    def _recover(self, start: int, end: int) -> None:
        """Copy the samples in a damaged range of bytes; each is verified by its own checksum."""
        for cdr in _samples_in(self._data, start, end):
            stamp_ns = decode_sample(bytes(cdr)).record.sample.stamp_ns
            message = self._file.message(SAMPLE_TOPIC, bytes(cdr), stamp_ns, stamp_ns, self._written[SAMPLE_TOPIC])
            self._write([(SAMPLE_TOPIC, message)])

    def _write(self, messages: list[tuple[str, Message]]) -> None:
        self._file.write_chunk([message for _, message in messages])
        self._written.update(topic for topic, _ in messages)

    def _counts(self) -> MessageCounts:
        """The last message counts of the file, corrected for the contents of the new one."""
        result = MessageCounts()
        before = (self._declared.counts or result).topics
        for topic in sorted(before.keys() | self._written.keys()):
            old = before.get(topic, TopicCounts())
            written, dropped = self._written[topic], Counter(old.dropped)
            lost = old.received - written - dropped.total()
            if lost > 0:
                dropped[_LOST] += lost
            result.topics[topic] = TopicCounts(written + dropped.total(), written, dropped, old.lost)
        return result


def _declarations(data: memoryview) -> Declarations:
    """From the records of a file that are intact, its verified chunks and its verified summary."""
    declared = Declarations()
    verified: list[Record | Damage] = []
    for item in walk_on(data):
        if isinstance(item, Record):
            declared.add(item)
            if isinstance(item.content, Chunk) and item.content.intact(data):
                verified += walk(data, item.content.start, item.content.end, IN_CHUNK)
    ends = summary_of(data)
    verified += [] if isinstance(ends, Damage) else walk(data, *ends, IN_SUMMARY)
    for item in verified:
        if isinstance(item, Record):
            declared.add(item)
    return declared


def samples_after_damage(data: memoryview, start: int) -> Iterator[memoryview]:
    """The intact samples from an invalid record on."""
    for item in walk_on(data, start):
        if isinstance(item, Damage):
            yield from _samples_in(data, item.offset, next_chunk(data, item.offset + 1))
        elif isinstance(item.content, Chunk) and not item.content.intact(data):
            yield from _samples_in(data, item.content.start, item.content.end)
        elif isinstance(item.content, Chunk):
            inside = walk(data, item.content.start, item.content.end, IN_CHUNK)
            messages = (one.content for one in inside if isinstance(one, Record))
            found = (data[one.start : one.end] for one in messages if isinstance(one, RecordedMessage))
            yield from filter(_is_readable, found)


def _samples_in(data: memoryview, start: int, end: int) -> Iterator[memoryview]:
    """The intact samples between two offsets, even if the records around them are damaged."""
    at = start
    for head, stop in _message_heads(data, start, end):
        if head < at:
            continue
        for last in sorted({stop, end}):
            cdr = data[head + _HEAD : last]
            if last <= end and _is_readable(cdr):
                yield cdr
                at = last
                break


def _message_heads(data: memoryview, start: int, end: int) -> list[tuple[int, int]]:
    """Possible start and end offsets of messages: from the records before the damage, and from byte patterns."""
    heads: dict[int, int] = {}
    for match in _MESSAGE_START.finditer(data, start, end):
        length = int.from_bytes(data[match.start() + 1 : match.start() + 9], "little")
        heads[match.start()] = match.start() + 9 + length
    for record in walk(data, start, end, IN_CHUNK):
        offset = record.offset
        heads[offset] = end if isinstance(record, Damage) else record.end
    return sorted(heads.items())


def _is_readable(cdr: memoryview) -> bool:
    """Whether the bytes are a complete sample; a `VersionError` if it is one of another version."""
    if not is_intact(cdr):
        return False
    try:
        decode_sample(bytes(cdr))
    except VersionError:
        raise
    except DatasetError:
        return False
    return True
