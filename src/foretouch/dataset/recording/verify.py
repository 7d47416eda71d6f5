# SPDX-License-Identifier: Apache-2.0
"""Verifies that a recording is unchanged: every byte of it is covered by a checksum.

Each chunk has a CRC-32, the whole data section another, index and summary a third; each sample has its own SHA-256,
and so does the manifest. Besides the bytes: samples can be decoded, ids are unique, the index matches the chunks, and
the message counts match the contents.
"""

import struct
import zlib
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from mcap.opcode import Opcode
from mcap.records import Channel, ChunkIndex, Header, Metadata, Schema, Statistics

from foretouch.dataset.recording import scan
from foretouch.dataset.recording.edits import read_edits
from foretouch.dataset.recording.folder import recorded_files
from foretouch.dataset.recording.mcap_file import MAGIC
from foretouch.dataset.recording.message_counts import MessageCounts
from foretouch.dataset.recording.messages import ABOUT, COUNTS, SAMPLE_TYPE, decode_sample
from foretouch.errors import DatasetError

_DECLARATIONS: Final = {Opcode.HEADER, Opcode.SCHEMA, Opcode.CHANNEL, Opcode.METADATA}
_DATA_RECORDS: Final = _DECLARATIONS | {Opcode.CHUNK, Opcode.MESSAGE_INDEX}
_FOOTER = struct.Struct("<QQI")
_MAX_FAULTS: Final = 100  # faults reported for one file


@dataclass(eq=False)
class FileReport:
    """The verification of one file."""

    path: Path  # the file
    size: int = 0  # its size [bytes]
    finished: bool = False  # whether it was closed
    ids: list[str] = field(default_factory=list)  # ids of its samples, in order
    messages: Counter[str] = field(default_factory=Counter)  # messages by topic
    counts: MessageCounts | None = None  # the last message counts in the file; None if there are none
    about: dict[str, str] = field(default_factory=dict)  # schema version, hand, camera and so on, as text
    faults: list[scan.Damage] = field(default_factory=list)  # the faults, with their offsets

    @property
    def clean(self) -> bool:
        """Whether there are no faults."""
        return not self.faults

    def fault_lines(self) -> list[str]:
        """The faults, one line each, with file and offset."""
        return [str(fault.error(self.path)) for fault in self.faults]


def verify_dataset(path: str | Path) -> list[FileReport]:
    """Verify the manifest, the log of edits and every recording of a dataset, or a single recording.

    Returns:
        One report a file; an id that two samples share is a fault of the later file.

    Raises:
        FileError: If there is no recorded dataset, or its manifest or log is damaged or of another version.
    """
    path = Path(path)
    files = recorded_files(path)
    if path.is_dir():
        read_edits(path)
    reports = [verify_file(file) for file in files]
    owners: dict[str, Path] = {}
    for report in reports:
        for sample_id in report.ids:
            if sample_id in owners:
                report.faults.append(scan.Damage(0, f"id {sample_id} is in {owners[sample_id].name} too"))
            owners.setdefault(sample_id, report.path)
    return reports


def verify_file(path: str | Path) -> FileReport:
    """Verify one recording.

    Raises:
        FileError: If it cannot be read.
    """
    report = FileReport(Path(path))
    with scan.mapped(report.path) as data:
        report.size = len(data)
        _Verification(report, data).run()
    del report.faults[_MAX_FAULTS:]
    return report


class _Verification:
    """One pass over one file."""

    def __init__(self, report: FileReport, data: memoryview) -> None:
        self.report = report
        self.data = data
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}
        self.found: Counter[int] = Counter()
        self.chunks: list[int] = []

    def run(self) -> None:
        if (damage := scan.magic_damage(self.data)) is not None:
            self.report.faults.append(damage)
        if (end := self._data_section()) is not None:
            self._summary(end)
        if not self.report.finished and self.report.clean:
            self._fault(len(self.data), "not finished: no index; repair creates one")
        for number, count in self.found.items():
            self.report.messages[self.channels[number].topic] += count
        self._check_counts()

    def _fault(self, offset: int, rule: str) -> None:
        self.report.faults.append(scan.Damage(offset, rule))

    def _data_section(self) -> scan.RawRecord | None:
        """Check up to the record that ends the data, and return that record; None if it is missing."""
        for number, record in enumerate(scan.records(self.data, len(MAGIC))):
            if isinstance(record, scan.Damage):
                self.report.faults.append(record)
                return None
            if number == 0 and not self._is_header(record):
                self._fault(record.offset, "damaged: no header of a ROS 2 recording")
            if record.opcode == Opcode.DATA_END:
                self._check_data_crc(record)
                return record
            if record.opcode not in _DATA_RECORDS:
                self._fault(record.offset, f"damaged: a record of number {record.opcode} is not allowed here")
            elif record.opcode == Opcode.CHUNK:
                self._chunk(record)
            else:
                self._declaration(record)
        return None

    def _is_header(self, record: scan.RawRecord) -> bool:
        header = scan.parse(Header, self.data, record) if record.opcode == Opcode.HEADER else None
        return isinstance(header, Header) and header.profile == "ros2"

    def _check_data_crc(self, record: scan.RawRecord) -> None:
        stored = int.from_bytes(self.data[record.start : record.end], "little")
        if stored != zlib.crc32(self.data[: record.offset]) or record.end - record.start != 4:
            self._fault(record.offset, "damaged: the bytes before do not match this checksum")

    def _chunk(self, record: scan.RawRecord) -> None:
        chunk = scan.chunk_at(self.data, record)
        if isinstance(chunk, scan.Damage):
            self.report.faults.append(chunk)
            return
        if not chunk.intact(self.data):
            self._fault(chunk.offset, "damaged: a chunk that does not match its checksum")
            return
        self.chunks.append(chunk.offset)
        for item in scan.messages_of(self.data, chunk.start, chunk.end):
            if isinstance(item, scan.Damage):
                self.report.faults.append(item)
            elif isinstance(item, scan.RawMessage):
                self._message(item)
            else:
                self._declaration(item)

    def _declaration(self, record: scan.RawRecord) -> None:
        content = scan.declaration(self.data, record)
        if isinstance(content, scan.Damage):
            self.report.faults.append(content)
        elif isinstance(content, Schema):
            self.schemas[content.id] = content
        elif isinstance(content, Channel):
            self.channels[content.id] = content
        elif isinstance(content, Metadata) and content.name == ABOUT:
            self.report.about = content.metadata
        elif isinstance(content, Metadata) and content.name == COUNTS:
            try:
                self.report.counts = MessageCounts.from_mapping(content.metadata)
            except DatasetError as err:
                self._fault(record.offset, str(err))

    def _message(self, message: scan.RawMessage) -> None:
        channel = self.channels.get(message.channel)
        schema = None if channel is None else self.schemas.get(channel.schema_id)
        if channel is None or schema is None:
            self._fault(message.start, f"a message of channel {message.channel}, which is not declared")
            return
        self.found[message.channel] += 1
        if schema.name != SAMPLE_TYPE:
            return
        try:
            stored = decode_sample(bytes(self.data[message.start : message.end]))
        except DatasetError as err:
            self._fault(message.start, f"sample: {err}")
        else:
            self.report.ids.append(stored.record.sample.id)

    def _summary(self, data_end: scan.RawRecord) -> None:
        chunks: list[int] = []
        for record in scan.records(self.data, data_end.end):
            if isinstance(record, scan.Damage):
                self.report.faults.append(record)
                return
            if record.opcode == Opcode.CHUNK_INDEX:
                index = scan.parse(ChunkIndex, self.data, record)
                chunks += [index.chunk_start_offset] if isinstance(index, ChunkIndex) else []
            elif record.opcode == Opcode.STATISTICS:
                self._statistics(record)
            elif record.opcode == Opcode.FOOTER:
                self._footer(data_end.end, record)
                if self.report.clean and chunks != self.chunks:
                    self._fault(data_end.end, f"the index holds {len(chunks)} chunks, {len(self.chunks)} are there")
                return
        self._fault(len(self.data), "cut off: no footer")

    def _statistics(self, record: scan.RawRecord) -> None:
        statistics = scan.parse(Statistics, self.data, record)
        declared = statistics.message_count if isinstance(statistics, Statistics) else None
        if self.report.clean and declared not in (None, self.found.total()):
            self._fault(record.offset, f"declares {declared} messages, {self.found.total()} are there")

    def _footer(self, summary: int, record: scan.RawRecord) -> None:
        self.report.finished = True
        if record.end - record.start != _FOOTER.size:
            self._fault(record.offset, "damaged: a footer of another size")
            return
        start, _, crc = _FOOTER.unpack_from(self.data, record.start)
        if start != summary or crc != zlib.crc32(self.data[summary : record.end - 4]):
            self._fault(record.offset, "damaged: the summary does not match its checksum")
        if bytes(self.data[record.end :]) != MAGIC:
            self._fault(record.end, "damaged: the file does not end as an MCAP file")

    def _check_counts(self) -> None:
        """Compare the message counts with the contents, if the file is otherwise clean."""
        if not (self.report.finished and self.report.clean):
            return
        if self.report.counts is None:
            self._fault(0, "holds no message counts")
            return
        topics, found = self.report.counts.topics, self.report.messages
        rules = self.report.counts.faults()
        for topic in sorted(topics.keys() | found.keys()):
            written = topics[topic].written if topic in topics else 0
            if written != found[topic]:
                rules.append(f"{topic}: {written} messages are counted as written, {found[topic]} are there")
        for rule in rules:
            self._fault(0, rule)
