# SPDX-License-Identifier: Apache-2.0
"""Repairs an unfinished or damaged recording, and keeps the original.

Everything that can be verified is kept: every chunk with a valid checksum, and every sample with a valid checksum in a
damaged chunk. Losses are reported with their offsets. The repaired file replaces the original in one step, and the
original is kept beside it as `<name>.before-repair`.
"""

import os
from collections import Counter
from contextlib import nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from foretouch import __version__
from foretouch.dataset.disk import disk_errors, sync_folder
from foretouch.dataset.recording.definitions import Definitions
from foretouch.dataset.recording.folder import lock, recorded_files
from foretouch.dataset.recording.mcap_file import MAGIC, McapFile, McapMessage
from foretouch.dataset.recording.message_counts import MessageCounts, TopicCounts
from foretouch.dataset.recording.messages import ABOUT, COUNTS, SAMPLE_TOPIC, SAMPLE_TYPE, decode_sample, is_intact
from foretouch.dataset.recording.recovery import Declarations, intact_parts, is_readable, samples_in
from foretouch.dataset.recording.scan import Chunk, Damage, RawMessage, RawRecord, mapped, messages_of, next_chunk
from foretouch.dataset.recording.verify import verify_file
from foretouch.errors import FileError

_KEPT: Final = ".before-repair"
_LOST: Final = "lost before repair"


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
        FileError: If another process records into the dataset, or its manifest is damaged or of another version.
    """
    path = Path(path)
    recorded_files(path)  # refuses other folders, before a lock file is created there
    with lock(path) if path.is_dir() else nullcontext():
        return [repair_file(file) for file in recorded_files(path)]


def repair_file(path: str | Path) -> RepairReport:
    """Repair one recording; a clean one is not changed.

    Raises:
        FileError: If it cannot be read or is no MCAP file, or the disk has no space for the repaired one.
    """
    path = Path(path)
    found = verify_file(path)
    report = RepairReport(path, samples=len(found.ids), messages=found.messages.total())
    if found.clean:
        return report
    report.changed = True
    part = path.with_name(f"{path.name}.repairing")
    part.unlink(missing_ok=True)
    try:
        with mapped(path) as data:
            if not MAGIC.startswith(bytes(data[: len(MAGIC)])) and next_chunk(data, 0) is None:
                raise FileError(path, "is no MCAP file, and holds no part of one")
            _write_repaired(part, data, report)
        report.original = _replace(path, part)
    finally:
        part.unlink(missing_ok=True)
    return report


def _replace(path: Path, repaired: Path) -> Path:
    """Replace the original by the repaired file; the original gets its second name before it loses the first."""
    kept = path.with_name(path.name + _KEPT)
    number = 2
    while kept.exists():
        kept = path.with_name(f"{path.name}{_KEPT}-{number}")
        number += 1
    with disk_errors(path, "cannot be replaced"):
        try:
            os.link(path, kept)
        except OSError:
            path.rename(kept)  # a file system without links: for a moment no file has the original's name
        repaired.replace(path)
        sync_folder(path.parent)
    return kept


def _write_repaired(part: Path, data: memoryview, report: RepairReport) -> None:
    declared = Declarations(data)
    file = McapFile(part, f"foretouch {__version__}")
    try:
        copy = _Copy(file, declared, report)
        file.write_metadata(ABOUT, {**declared.about, "repaired_by": f"foretouch {__version__}"})
        for item in intact_parts(data):
            copy.add(data, item)
        report.messages = file.message_count
        file.write_metadata(COUNTS, copy.counts().to_mapping())
        file.finish()
    finally:
        file.abandon()


class _Copy:
    """Copies the intact parts into a new file."""

    def __init__(self, file: McapFile, declared: Declarations, report: RepairReport) -> None:
        self._file = file
        self._declared = declared
        self._report = report
        self._numbers: dict[int, int] = {}
        self._topics: dict[str, int] = {}
        self._written: Counter[str] = Counter()
        self._chunk_end: int | None = None
        definition = Definitions().text(SAMPLE_TYPE)  # the file's own copy may be damaged
        self._declare(SAMPLE_TOPIC, SAMPLE_TYPE, definition, "")
        for number, channel in sorted(declared.channels.items()):
            schema = declared.schemas.get(channel.schema_id)
            if schema is not None and channel.message_encoding == "cdr" and schema.encoding == "ros2msg":
                qos = channel.metadata.get("offered_qos_profiles", "")
                text = definition if schema.name == SAMPLE_TYPE else schema.data.decode("utf-8", "replace")
                self._numbers[number] = self._declare(channel.topic, schema.name, text, qos)

    def add(self, data: memoryview, item: Chunk | RawRecord | Damage) -> None:
        """Copy one item of `intact_parts`."""
        if isinstance(item, Chunk):
            if item.intact(data):
                self._copy_chunk(data, item)
            else:
                self._report.lost.append(Damage(item.offset, "damaged: a chunk that does not match its checksum"))
                self._recover(data, item.start, item.end)
        elif isinstance(item, Damage):
            self._report.lost.append(item)
            following = next_chunk(data, item.offset + 1)
            self._recover(data, item.offset, len(data) if following is None else following.offset)

    def counts(self) -> MessageCounts:
        """The last message counts of the file, corrected for the contents of the new one."""
        result = MessageCounts()
        for topic in sorted(self._declared.counts.topics.keys() | self._written.keys()):
            old = self._declared.counts.topics.get(topic, TopicCounts())
            written, dropped = self._written[topic], Counter(old.dropped)
            lost = old.received - written - dropped.total()
            if lost > 0:
                dropped[_LOST] += lost
            result.topics[topic] = TopicCounts(written + dropped.total(), written, dropped, old.lost)
        return result

    def _declare(self, topic: str, type_name: str, definition: str, qos: str) -> int:
        if topic not in self._topics:
            self._topics[topic] = self._file.add_channel(topic, type_name, definition, qos)
        return self._topics[topic]

    def _copy_chunk(self, data: memoryview, chunk: Chunk) -> None:
        kept: list[McapMessage] = []
        topics: list[str] = []
        names = {number: topic for topic, number in self._topics.items()}
        for item in messages_of(data, chunk.start, chunk.end):
            if isinstance(item, Damage):
                self._report.lost.append(item)
            elif isinstance(item, RawMessage):
                number = self._numbers.get(item.channel)
                cdr = data[item.start : item.end]
                if number is None and is_intact(cdr):
                    number = self._topics[SAMPLE_TOPIC]
                if number is None or (number == self._topics[SAMPLE_TOPIC] and not is_readable(cdr)):
                    self._report.lost.append(Damage(item.start, "a message whose declaration or content is damaged"))
                    continue
                kept.append(McapMessage(number, cdr, item.log_time_ns, item.publish_time_ns, item.sequence))
                topics.append(names[number])
        self._write(kept, topics)

    def _recover(self, data: memoryview, start: int, end: int) -> None:
        """Copy the samples in a damaged range of bytes; each is verified by its own checksum."""
        for cdr in samples_in(data, start, end):
            stamp_ns = decode_sample(bytes(cdr)).record.sample.stamp_ns
            number = self._topics[SAMPLE_TOPIC]
            self._write([McapMessage(number, cdr, stamp_ns, stamp_ns, self._report.samples)], [SAMPLE_TOPIC])

    def _write(self, messages: list[McapMessage], topics: list[str]) -> None:
        self._file.write_chunk(messages)
        self._written.update(topics)
        self._report.samples = self._written[SAMPLE_TOPIC]
