# SPDX-License-Identifier: Apache-2.0
"""Verifies that a recording is unchanged: every byte of it is covered by a checksum.

Each chunk has a CRC-32, the whole data section another, index and summary a third; each sample has its own SHA-256,
and so does the manifest. Besides the bytes: samples can be decoded, ids are unique, the index matches the chunks, and
the message counts match the contents. A session that is missing, or another one than the manifest lists, is a fault too (see
`folder`).
"""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from mcap.opcode import Opcode
from mcap.records import ChunkIndex, Header, Statistics

from foretouch.dataset.recording.edits import read_edits
from foretouch.dataset.recording.folder import (
    ID,
    REPAIRED,
    Session,
    about_in,
    index_sha256,
    listed_sessions,
    recorded_files,
    recorded_sensor,
    session_files,
)
from foretouch.dataset.recording.records import (
    IN_SUMMARY,
    Chunk,
    Damage,
    Declarations,
    MessageCounts,
    RecordedMessage,
    contents,
    is_finished,
    magic_damage,
    summary_of,
    walk,
)
from foretouch.dataset.recording.sample_codec import SAMPLE_TYPES, decode_sample
from foretouch.errors import DatasetError, FileError
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
    if not path.is_dir():
        return [verify_file(path)]
    sensor = recorded_sensor(path)
    read_edits(path)
    reports = {file: verify_file(file, sensor) for file in files}
    owners: dict[str, Path] = {}
    for report in reports.values():
        for sample_id in report.ids:
            if sample_id in owners:
                report.faults.append(Damage(0, f"id {sample_id} is in {owners[sample_id].name} too"))
            owners.setdefault(sample_id, report.path)
    for file, rule in chain_faults(path):
        reports.setdefault(file, FileReport(file, finished=True)).faults.append(Damage(0, rule))
    return list(reports.values())


def chain_faults(path: Path) -> list[tuple[Path, str]]:
    """Each file of a dataset that contradicts the list, and the rule; none without a list."""
    faults = list(_differences(path))
    return list(_differences(path)) if faults else []  # a recorder may have begun or ended a session meanwhile


def require_chain(path: Path) -> None:
    """Raise a `FileError` for the first of `chain_faults`, but for a file that is cut off, as which it is read."""
    for file, rule in chain_faults(path):
        if not file.exists() or is_finished(FileBytes(file)):
            raise FileError(file, rule)


def _differences(path: Path) -> Iterator[tuple[Path, str]]:
    files = session_files(path)
    sessions = listed_sessions(path)
    if sessions is None:
        return
    for session in sessions:
        file = path / session.file
        if not file.exists():
            ended = f"with {session.samples} samples" if session.sha256 else "as not finished"
            yield file, f"is missing: the manifest lists it {ended}"
        elif rule := _difference(session, FileBytes(file)):
            yield file, rule
    listed = {session.file for session in sessions}
    for file in files:
        if file.name not in listed and (is_finished(data := FileBytes(file)) or _holds_message(data)):
            yield file, "is not in the list of the manifest: it was added by hand"


def _difference(session: Session, data: FileBytes) -> str:
    about = about_in(data)
    if about and about.get(ID, "") != session.id:
        return "is the file of another session than the manifest lists"
    index = summary_of(data)
    if not session.sha256 or REPAIRED in about:  # a crash may end a session or a repair before it is listed
        return ""
    if isinstance(index, Damage):
        return f"is not the session of {session.samples} samples that the manifest lists: {index.rule}"
    same = index_sha256(data, index[0]) == session.sha256
    return "" if same else "is not the session that the manifest lists: its index has another hash"


def _holds_message(data: FileBytes) -> bool:
    return any(isinstance(one, RecordedMessage) for one in contents(data, Declarations()))


def verify_file(path: Path, sensor: Sensor | None = None) -> FileReport:
    """Verify one recording, by a sensor if its samples must be of it; a `FileError` if it cannot be read."""
    data = FileBytes(path)
    report = FileReport(path, len(data), is_finished(data))
    for fault in _faults(report, data, sensor):
        report.faults.append(fault)  # one at a time: some checks are made only where there are none so far
    del report.faults[100:]  # so many are reported for one file
    return report


def _faults(report: FileReport, data: FileBytes, sensor: Sensor | None) -> Iterator[Damage]:
    """Find all faults, and fill the report meanwhile."""
    if damage := magic_damage(data):
        yield damage
    chunks, data_end = [], None
    for number, item in enumerate(contents(data, report.declared)):
        if isinstance(item, Damage):
            yield item
            continue
        if isinstance(item, RecordedMessage):
            yield from _message_faults(report, data, item, sensor)
            continue
        if number == 0 and not (isinstance(item.content, Header) and item.content.profile == "ros2"):
            yield Damage(item.offset, "damaged: no header of a ROS 2 recording")
        if isinstance(item.content, Chunk):
            chunks.append(item.offset)
        if item.opcode == Opcode.DATA_END:
            data_end = item.end
            if item.content.data_section_crc != data.crc32(0, item.offset):
                yield Damage(item.offset, "damaged: the bytes before do not match this checksum")
    summary = summary_of(data)
    if not isinstance(summary, Damage):
        yield from _summary_faults(report, data, summary, data_end, chunks)
    elif data_end is not None or report.finished:
        yield summary
    elif report.clean:
        yield Damage(len(data), "not finished: no index; repair creates one")
    if report.clean:
        yield from _count_faults(report)


def _message_faults(
    report: FileReport, data: FileBytes, message: RecordedMessage, sensor: Sensor | None
) -> Iterator[Damage]:
    type_name = report.declared.type_of(message.channel)
    if not type_name:
        yield Damage(message.start, f"a message of channel {message.channel}, which is not declared")
        return
    report.messages[report.declared.channels[message.channel].topic] += 1
    if type_name in SAMPLE_TYPES:
        try:
            report.ids.append(decode_sample(data[message.start : message.end], sensor).record.sample.id)
        except DatasetError as err:
            yield Damage(message.start, f"sample: {err}")


def _summary_faults(
    report: FileReport, data: FileBytes, summary: tuple[int, int], data_end: int | None, chunks: list[int]
) -> Iterator[Damage]:
    """Compare the summary between two offsets with the chunks that were found, and the end of the data."""
    indexed = []
    for record in walk(data, *summary, IN_SUMMARY):
        if isinstance(record, Damage):
            yield record
            continue
        report.declared.add(record)
        if isinstance(record.content, ChunkIndex):
            indexed.append(record.content.chunk_start_offset)
        elif isinstance(record.content, Statistics) and report.clean:
            declared, found = record.content.message_count, report.messages.total()
            if declared != found:
                yield Damage(record.offset, f"declares {declared} messages, {found} are there")
    if report.clean and (summary[0] != data_end or indexed != chunks):
        yield Damage(summary[0], f"the index holds {len(indexed)} chunks, {len(chunks)} are there")


def _count_faults(report: FileReport) -> Iterator[Damage]:
    """Compare the message counts with the contents."""
    if report.counts is None:
        yield Damage(0, "holds no message counts")
        return
    for topic in sorted(report.counts.topics.keys() | report.messages.keys()):
        counts, found = report.counts.topic(topic), report.messages[topic]
        if counts.pending:
            total = f"written {counts.written} + dropped {counts.dropped.total()}"
            yield Damage(0, f"{topic}: received {counts.received} is not {total}")
        if counts.written != found:
            yield Damage(0, f"{topic}: {counts.written} messages are counted as written, {found} are there")
