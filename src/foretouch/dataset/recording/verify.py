# SPDX-License-Identifier: Apache-2.0
"""Verifies that a recording is unchanged: every byte of it is covered by a checksum.

Each chunk has a CRC-32, the whole data section another, index and summary a third; each sample has its own SHA-256,
and so does the manifest. Besides the bytes: samples can be decoded, ids are unique, the index matches the chunks, and
the message counts match the contents.
"""

from collections import Counter
from collections.abc import Generator, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from mcap.opcode import Opcode
from mcap.records import ChunkIndex, Header, Statistics

from foretouch.dataset.recording.chain import chain_faults
from foretouch.dataset.recording.edits import read_edits
from foretouch.dataset.recording.folder import recorded_files, recorded_sensor
from foretouch.dataset.recording.records import (
    IN_CHUNK,
    IN_SUMMARY,
    Chunk,
    Damage,
    Declarations,
    MessageCounts,
    RecordedMessage,
    is_finished,
    magic_damage,
    summary_of,
    walk,
    walk_on,
)
from foretouch.dataset.recording.sample_codec import SAMPLE_TYPES, decode_sample
from foretouch.errors import DatasetError
from foretouch.files import FileBytes
from foretouch.tactile.description import Sensor


@dataclass(eq=False)
class FileReport:
    """The verification of one file."""

    path: Path  # the file
    size: int = 0  # its size [bytes]
    finished: bool = False  # whether it was closed
    ids: list[str] = field(default_factory=list)  # ids of its samples, in order
    messages: Counter[str] = field(default_factory=Counter)  # messages by topic
    declared: Declarations = field(default_factory=Declarations)  # its topics, its message counts and so on
    faults: list[Damage] = field(default_factory=list)  # the faults, with their offsets

    @property
    def clean(self) -> bool:
        """Whether there are no faults."""
        return not self.faults

    @property
    def counts(self) -> MessageCounts | None:
        """The last message counts in the file; None if there are none."""
        return self.declared.counts

    def fault_lines(self) -> list[str]:
        """The faults, one line each, with file and offset."""
        return [str(fault.error(self.path)) for fault in self.faults]


def verify_dataset(path: str | Path) -> list[FileReport]:
    """Verify the manifest, the log of edits and every recording of a dataset, or a single recording: one report a file.

    An id that two samples share is a fault of the later file, and a file that is missing or not the one that the manifest
    lists has a fault, as has a sample of another sensor. A `FileError` if there is no recorded dataset, or its manifest or
    log is damaged; a `ConfigError` if the sensor's description in the manifest is.
    """
    path = Path(path)
    files = recorded_files(path)
    sensor = recorded_sensor(path) if path.is_dir() else None
    if path.is_dir():
        read_edits(path)
    reports = [verify_file(file, sensor) for file in files]
    owners: dict[str, Path] = {}
    for report in reports:
        for sample_id in report.ids:
            if sample_id in owners:
                report.faults.append(Damage(0, f"id {sample_id} is in {owners[sample_id].name} too"))
            owners.setdefault(sample_id, report.path)
    by_file = {report.path: report for report in reports}
    for file, rule in chain_faults(path) if path.is_dir() else ():
        if file not in by_file:
            reports.append(by_file.setdefault(file, FileReport(file, finished=True)))
        by_file[file].faults.append(Damage(0, rule))
    return reports


def verify_file(path: Path, sensor: Sensor | None = None) -> FileReport:
    """Verify one recording, by a sensor if its samples must be of it; a `FileError` if it cannot be read."""
    report = FileReport(path)
    for fault in _Verification(report, FileBytes(path), sensor).faults():
        report.faults.append(fault)  # one at a time: some checks are made only where there are none so far
    del report.faults[100:]  # so many are reported for one file
    return report


class _Verification:
    """One pass over one file."""

    def __init__(self, report: FileReport, data: FileBytes, sensor: Sensor | None) -> None:
        self.report = report
        self.data = data
        self.sensor = sensor
        self.declared = report.declared
        self.found: Counter[int] = Counter()
        self.chunks: list[int] = []
        report.size = len(data)
        report.finished = is_finished(data)

    def faults(self) -> Iterator[Damage]:
        """Find all faults, and fill the report meanwhile."""
        if damage := magic_damage(self.data):
            yield damage
        data_end = yield from self._data_section()
        summary = summary_of(self.data)
        if not isinstance(summary, Damage):
            yield from self._summary(data_end, *summary)
        elif data_end is not None or self.report.finished:
            yield summary
        elif self.report.clean:
            yield Damage(len(self.data), "not finished: no index; repair creates one")
        for number, count in self.found.items():
            self.report.messages[self.declared.channels[number].topic] += count
        if self.report.clean:
            yield from self._count_faults()

    def _data_section(self) -> Generator[Damage, None, int | None]:
        """Check up to the record that ends the data, and return where that record ends; None if it is not reached."""
        for number, record in enumerate(walk_on(self.data)):
            if isinstance(record, Damage):
                yield record
                continue
            if number == 0 and not (isinstance(record.content, Header) and record.content.profile == "ros2"):
                yield Damage(record.offset, "damaged: no header of a ROS 2 recording")
            if record.opcode == Opcode.DATA_END:
                if record.content.data_section_crc != self.data.crc32(0, record.offset):
                    yield Damage(record.offset, "damaged: the bytes before do not match this checksum")
                return record.end
            if damage := self.declared.add(record):
                yield damage
            if isinstance(record.content, Chunk):
                yield from self._chunk(record.offset, record.content)
        return None

    def _chunk(self, offset: int, chunk: Chunk) -> Iterator[Damage]:
        if not chunk.intact(self.data):
            yield Damage(offset, "damaged: a chunk that does not match its checksum")
            return
        self.chunks.append(offset)
        for item in walk(self.data, chunk.start, chunk.end, IN_CHUNK):
            if isinstance(item, Damage):
                yield item
            elif isinstance(item.content, RecordedMessage):
                yield from self._message(item.content)
            else:
                self.declared.add(item)

    def _message(self, message: RecordedMessage) -> Iterator[Damage]:
        type_name = self.declared.type_of(message.channel)
        if not type_name:
            yield Damage(message.start, f"a message of channel {message.channel}, which is not declared")
            return
        self.found[message.channel] += 1
        if type_name not in SAMPLE_TYPES:
            return
        try:
            stored = decode_sample(self.data[message.start : message.end], self.sensor)
            self.report.ids.append(stored.record.sample.id)
        except DatasetError as err:
            yield Damage(message.start, f"sample: {err}")

    def _summary(self, data_end: int | None, start: int, end: int) -> Iterator[Damage]:
        chunks = []
        for record in walk(self.data, start, end, IN_SUMMARY):
            if isinstance(record, Damage):
                yield record
                continue
            self.declared.add(record)
            if isinstance(record.content, ChunkIndex):
                chunks.append(record.content.chunk_start_offset)
            elif isinstance(record.content, Statistics) and self.report.clean:
                declared, found = record.content.message_count, self.found.total()
                if declared != found:
                    yield Damage(record.offset, f"declares {declared} messages, {found} are there")
        if self.report.clean and (start != data_end or chunks != self.chunks):
            yield Damage(start, f"the index holds {len(chunks)} chunks, {len(self.chunks)} are there")

    def _count_faults(self) -> Iterator[Damage]:
        """Compare the message counts with the contents."""
        if self.report.counts is None:
            yield Damage(0, "holds no message counts")
            return
        found = self.report.messages
        for topic in sorted(self.report.counts.topics.keys() | found.keys()):
            counts = self.report.counts.topic(topic)
            if counts.pending:
                total = f"written {counts.written} + dropped {counts.dropped.total()}"
                yield Damage(0, f"{topic}: received {counts.received} is not {total}")
            if counts.written != found[topic]:
                yield Damage(0, f"{topic}: {counts.written} messages are counted as written, {found[topic]} are there")
