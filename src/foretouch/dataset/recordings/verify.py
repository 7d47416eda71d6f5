# SPDX-License-Identifier: Apache-2.0
"""Verifies that a recording is unchanged: every byte of it is covered by a checksum.

In a file of others, what has a checksum and what it counts is verified. Each chunk has a CRC-32, the whole data section another, and the index a third; each sample has its own SHA-256, and so does
the manifest. Besides the bytes: samples can be decoded, ids are unique, and the message counts match the contents.
"""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from foretouch.dataset.recordings.edits import read_edits
from foretouch.dataset.recordings.folder import SESSIONS, is_dataset, recorded_files, recorded_sensor, stated
from foretouch.dataset.recordings.mcap import Damage
from foretouch.dataset.recordings.reader import session_id
from foretouch.dataset.recordings.records import MessageCounts, RecordingFile
from foretouch.dataset.recordings.sample_codec import SAMPLE_TYPES, decode_sample
from foretouch.errors import DatasetError
from foretouch.tactile.description import Sensor


@dataclass(eq=False)
class FileReport:
    """The verification of one file."""

    path: Path  # the file
    size: int = 0  # its size [bytes]
    finished: bool = False  # whether it was closed
    ids: list[str] = field(default_factory=list)  # ids of its samples, in order
    messages: Counter[str] = field(default_factory=Counter)  # messages by topic
    counts: MessageCounts | None = None  # the last message counts in the file; None without them
    faults: list[Damage] = field(default_factory=list)  # the faults, with their offsets

    @property
    def clean(self) -> bool:
        """Whether there are no faults."""
        return not self.faults

    def fault_lines(self) -> list[str]:
        """Return the faults, one line each, with file and offset."""
        return [str(fault.error(self.path)) for fault in self.faults]


def verify_dataset(path: str | Path) -> list[FileReport]:
    """Verify the manifest, the log of edits and every recording of a dataset, or a single recording: one report a file.

    An id that two samples share is a fault of the later file, as is a sample of another sensor. A `FileError` if there is no recorded
    dataset, or its manifest or log is damaged; a `ConfigError` if the sensor's description in the manifest is.
    """
    path = Path(path)
    files = recorded_files(path, complete=False)
    if not is_dataset(path):
        return [verify_file(RecordingFile(file)) for file in files]
    sensor = recorded_sensor(path)
    read_edits(path)
    reports = [verify_file(RecordingFile(file), sensor) for file in files]
    for name, session in sorted(stated(path, SESSIONS).items()):
        report = next((candidate for candidate in reports if candidate.path.name == name), None)
        if report is None:
            reports.append(FileReport(path / name, faults=[Damage(0, "is absent, though the manifest lists it")]))
        elif session_id(report.path) != session:
            report.faults.append(Damage(0, "is another recording than the manifest lists under this name"))
    owners: dict[str, Path] = {}
    for report in reports:
        for sample_id in report.ids:
            if sample_id in owners:
                report.faults.append(Damage(0, f"id {sample_id} is in {owners[sample_id].name} too"))
            owners.setdefault(sample_id, report.path)
    return reports


def verify_file(file: RecordingFile, sensor: Sensor | None = None) -> FileReport:
    """Verify one recording, by a sensor if its samples must be of it; a `FileError` if it cannot be read."""
    report = FileReport(file.path, len(file.data), file.finished)
    for item in file.messages():
        if isinstance(item, Damage):
            report.faults.append(item)
            continue
        report.messages[item.topic] += 1
        if item.channel not in file.channels or (file.channels[item.channel].schema_id and not item.type):
            report.faults.append(Damage(item.offset, "a message of a channel or schema that is not declared"))
        elif item.type in SAMPLE_TYPES:
            try:
                report.ids.append(decode_sample(file.content(item), sensor).sample.id)
            except DatasetError as err:
                report.faults.append(Damage(item.offset, f"sample: {err}"))
    report.counts = file.counts
    if report.clean and not report.finished:
        report.faults.append(Damage(report.size, "not finished: no index; repair creates one"))
    if report.clean:
        report.faults += _count_faults(report) if file.is_own else _index_faults(file, report)
    del report.faults[100:]  # which are reported for one file
    return report


def _count_faults(report: FileReport) -> Iterator[Damage]:
    """Compare the message counts with the contents."""
    if report.counts is None:
        yield Damage(0, "holds no message counts")
        return
    for topic in sorted(report.counts.topics.keys() | report.messages.keys()):
        counts, present = report.counts.topic(topic), report.messages[topic]
        if counts.pending:
            total = f"written {counts.written} + dropped {counts.dropped.total()}"
            yield Damage(0, f"{topic}: received {counts.received} is not {total}")
        if counts.written != present:
            yield Damage(0, f"{topic}: {counts.written} messages are counted as written, {present} are there")


def _index_faults(file: RecordingFile, report: FileReport) -> Iterator[Damage]:
    """Compare the counts in the index of a file of others, if it has some, with the contents."""
    counted, present = file.statistics.message_count if file.statistics else 0, report.messages.total()
    if file.statistics and counted != present:
        yield Damage(0, f"the index counts {counted} messages, {present} are there")
