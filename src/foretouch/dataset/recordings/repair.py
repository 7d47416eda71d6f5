# SPDX-License-Identifier: Apache-2.0
"""Repairs an unfinished or damaged recording, and keeps the original.

Every chunk with a valid checksum is kept, of one that is cut off the messages before the cut, and each sample has a chunk of
its own. Losses are reported with their offsets. The repaired file replaces the original in one step, and the original is kept
beside it as `<name>.before-repair`. Any MCAP file can be repaired; where nothing could be kept, it stays as it is.
"""

import os
import struct
from collections import Counter
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Final

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Message, Metadata
from mcap.writer import CompressionType

from foretouch.base.files import free_name, lock, system_errors
from foretouch.dataset.files import sync_folder
from foretouch.dataset.recordings import folder
from foretouch.dataset.recordings.edits import EDITS, read_edits
from foretouch.dataset.recordings.folder import SESSIONS, is_dataset, recorded_files, restate, stated
from foretouch.dataset.recordings.mcap import LIBRARY, MAGIC, Damage, McapFile
from foretouch.dataset.recordings.reader import readable, session_id
from foretouch.dataset.recordings.records import MessageCounts, RecordingFile, TopicCounts
from foretouch.dataset.recordings.sample_codec import (
    ABOUT,
    COUNTS,
    SAMPLE_TOPIC,
    SAMPLE_TYPE,
    SAMPLE_TYPES,
    sample_types,
)
from foretouch.dataset.recordings.verify import verify_file
from foretouch.errors import FileError, VersionError, described

_CHUNK_BYTES: Final = 4_000_000


@dataclass(eq=False)
class RepairReport:
    """The repair of one file."""

    path: Path  # the file
    changed: bool = False  # whether it needed a repair
    samples: int = 0  # samples in it now
    messages: int = 0  # messages in it now, including samples
    original: Path | None = None  # the file that keeps the original, or None
    lost: list[Damage] = field(default_factory=list)  # the parts that were not kept, with their offsets in the original
    refusal: str = ""  # why a file of several stays as it is although it is damaged


def repair_dataset(path: str | Path) -> list[RepairReport]:
    """Repair every recording of a dataset that needs it, or a single file; a log of edits that is damaged is renamed.

    Raises:
        FileError: If another process records into it, it is not a recording; for a single file also if it is of another version, holds
            nothing that could be kept, or the disk is full.
    """
    path = Path(path)
    if any(path.glob("shard-*.arrow")) and not is_dataset(path):
        rule = "is a training store, which is not repaired: `foretouch dataset verify` names its damage, "
        raise FileError(path, rule + "`foretouch dataset build` writes it anew from its recordings")
    files = recorded_files(path, complete=False)  # refuses other folders, before a lock file is created there
    if path.is_file():
        return [_repair_file(path)]
    if not is_dataset(path):
        return [_repaired_or_refused(file) for file in files]
    with lock(path):
        reports = [_repaired_or_refused(file) for file in files]
        present = {file.name: session_id(file) for file in files}
        for name, session in stated(path, SESSIONS).items():
            if present.get(name) != session:
                rule = (
                    "has another id than the manifest listed, and is now"
                    if name in present
                    else "is absent, and no longer"
                )
                reports.append(RepairReport(path / name, changed=True, lost=[Damage(0, f"{rule} listed")]))
        if present != stated(path, SESSIONS):
            restate(path, SESSIONS, present)
        try:
            read_edits(path)
        except FileError as err:
            kept = free_name(path / EDITS, "before-repair") if (path / EDITS).exists() else None
            with system_errors(path / EDITS):
                if kept is not None:
                    (path / EDITS).rename(kept)
            restate(path, folder.EDITS, {})
            reports.append(RepairReport(path / EDITS, changed=True, original=kept, lost=[Damage(0, err.rule)]))
        return reports


def _repaired_or_refused(path: Path) -> RepairReport:
    try:
        return _repair_file(path)
    except FileError as err:
        return RepairReport(path, refusal=str(err))


def _repair_file(path: Path) -> RepairReport:
    """Repair one recording; a clean one is not changed."""
    file = RecordingFile(path)
    verified = verify_file(file)
    report = RepairReport(path, samples=len(verified.ids), messages=verified.messages.total())
    if verified.clean:
        return report
    report.changed = True
    part = path.with_name(f"{path.name}.repairing")
    part.unlink(missing_ok=True)
    try:
        if not MAGIC.startswith(file.data[: len(MAGIC)]) and file.next_chunk(0) == len(file.data):
            raise FileError(path, "is not an MCAP file, and holds no part of one")
        name = "" if file.is_own else file.compression.upper()
        compression = CompressionType.__members__.get(name, CompressionType.NONE)
        _copy_intact(file, McapFile(part, None if file.is_own else file.header, compression), report)
        only_cut = len(file.data) <= len(MAGIC) or all(damage.rule.startswith("cut off") for damage in report.lost)
        if not report.messages and not (file.is_own and only_cut and not file.compression):
            rule = report.lost[0].rule if report.lost else "it has no end"
            raise FileError(path, f"holds no message that could be kept, and stays as it is: {rule}")
        report.original = _replace(path, part)
    except VersionError as err:
        raise FileError(path, str(err)) from err
    finally:
        part.unlink(missing_ok=True)
    return report


def _replace(path: Path, repaired: Path) -> Path:
    """Replace the original by the repaired file; the original gets its second name before it loses the first."""
    kept = free_name(path, "before-repair")
    with system_errors(path, "cannot be replaced"):
        try:
            os.link(path, kept)
        except OSError:
            path.rename(kept)  # a file system without links: for a moment no file has the original's name
        repaired.replace(path)
        sync_folder(path.parent)
    return kept


def _copy_intact(file: RecordingFile, out: McapFile, report: RepairReport) -> None:
    """Copy the intact parts of a file that was verified into a new one, and add to the report what is lost."""
    pending: list[Message] = []
    written: Counter[str] = Counter()
    numbers: dict[int, int] = {}  # of channels in the new file
    samples = undeclared = sample_number = 0

    def flush() -> None:
        out.write_chunk(pending)
        pending.clear()

    try:
        if file.is_own:
            out.write_metadata(ABOUT, {**file.metadata.get(ABOUT, {}), "repaired_by": LIBRARY})
            sample_number = out.declare(
                SAMPLE_TOPIC, SAMPLE_TYPE, sample_types().text(SAMPLE_TYPE)
            )  # the file's own may be damaged
        _copy_extras(file, out, report)
        for number, channel in file.channels.items():
            schema = file.schemas.get(channel.schema_id)
            if not file.is_own or (schema is not None and channel.topic != SAMPLE_TOPIC):
                numbers[number] = out.add_channel(channel, schema)
        for item in file.messages():
            if isinstance(item, Damage):
                report.lost.append(item)
                continue
            is_sample = item.type in SAMPLE_TYPES or (file.is_own and item.channel not in numbers)
            if is_sample and readable(file, item) is None:
                report.lost.append(Damage(item.offset, "a message whose declaration or content is damaged"))
                continue
            if not is_sample and item.channel not in numbers:
                undeclared += 1
                continue
            if is_sample or sum(len(message.data) for message in pending) > _CHUNK_BYTES:
                flush()
            number = numbers.get(item.channel, sample_number)
            pending.append(Message(number, item.log_time_ns, file.content(item), item.publish_time_ns, item.sequence))
            written[SAMPLE_TOPIC if number == sample_number else item.topic] += 1
            samples += is_sample
            if is_sample:  # which gets its own chunk
                flush()
        flush()
        report.messages, report.samples = written.total(), samples
        if undeclared:
            report.lost.append(Damage(0, f"{undeclared} messages of channels that are not declared"))
        if file.is_own:
            out.write_metadata(COUNTS, _corrected(file.counts or MessageCounts(), written).to_mapping())
        out.finish()
    finally:
        out.abandon()


def _copy_extras(file: RecordingFile, out: McapFile, report: RepairReport) -> None:
    """Copy attachments, and metadata that are not the recorder's, as far as they are intact."""
    for record in file.extras:
        stream = ReadDataStream(BytesIO(file.data[record.start : record.end]))
        try:
            if record.opcode == Opcode.ATTACHMENT:
                out.write_attachment(Attachment.read(stream))
            elif (metadata := Metadata.read(stream)).name not in {ABOUT, COUNTS} or not file.is_own:
                out.write_metadata(metadata.name, metadata.metadata)
        except (ValueError, struct.error, McapError) as err:
            report.lost.append(Damage(record.offset, f"damaged: {described(err)}"))


def _corrected(counts: MessageCounts, written: Counter[str]) -> MessageCounts:
    """Return the last message counts of a file, corrected for what is written in the new one."""
    result = MessageCounts()
    for topic in sorted(counts.topics.keys() | written.keys()):
        old = counts.topics.get(topic, TopicCounts())
        dropped = Counter(old.dropped)
        lost = old.received - written[topic] - dropped.total()
        if lost > 0:
            dropped["lost before repair"] += lost
        result.topics[topic] = TopicCounts(written[topic] + dropped.total(), written[topic], dropped, old.lost)
    return result
