# SPDX-License-Identifier: Apache-2.0
"""Reads the samples of a recorded dataset, in the order of their recording.

Samples are found without reading other messages. A recording that was cut off is read as far as it is intact.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from foretouch.base.files import open_regular
from foretouch.dataset.identity import Identity
from foretouch.dataset.recordings.edits import EditLog, read_edits
from foretouch.dataset.recordings.folder import (
    SESSIONS,
    is_dataset,
    recorded_files,
    recorded_sensor,
    session_files,
    stated,
)
from foretouch.dataset.recordings.mcap import MAGIC, Damage, RecordedMessage
from foretouch.dataset.recordings.records import MessageCounts, RecordingFile, TopicCounts
from foretouch.dataset.recordings.sample_codec import ABOUT, SAMPLE_TOPIC, SAMPLE_TYPES, StoredSample, decode_sample
from foretouch.dataset.samples import SampleSet
from foretouch.errors import DatasetError, FileError, VersionError
from foretouch.tactile.channels import BIOTAC_SP
from foretouch.tactile.description import Sensor
from foretouch.types import Sample


class RecordedDataset:
    """The samples of a recorded dataset, or of one of its `.mcap` files.

    A `FileError` names file and position if the path is not a recorded dataset, or a manifest or recording is damaged.

    Attributes:
        edits: What is applied to the samples.
        unfinished: Recordings that were cut off, which are read as far as they are intact.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        files = [RecordingFile(file) for file in recorded_files(self.path)]
        self._stated_sensor = recorded_sensor(self.path) if self.path.is_dir() else None  # by the manifest
        self.edits = read_edits(self.path) if self.path.is_dir() else EditLog()
        self.unfinished = [file.path for file in files if not file.finished]
        self._samples = [(file, message) for file in files for message in samples_in(file)]
        self._files = files

    def __len__(self) -> int:
        return len(self._samples)

    def __getitem__(self, index: int) -> Sample:
        """Read one sample with the edits applied, verified by its SHA-256; a `FileError` names the position of damage."""
        return self.edits.apply(self.as_recorded(index))

    def __iter__(self) -> Iterator[Sample]:
        for k in range(len(self)):
            yield self[k]

    @property
    def identity(self) -> Identity:
        """Hand and camera, as the first sample states them."""
        return self._read(0).identity if self._samples else Identity()

    @property
    def sensor(self) -> Sensor:
        """The sensor that was read."""
        if self._stated_sensor is None and self._samples:
            return self._read(0).sensor
        return self._stated_sensor or BIOTAC_SP

    def as_recorded(self, index: int) -> Sample:
        """Read one sample before any edit; a `FileError` names the position of damage."""
        return self._read(index).sample

    def _read(self, index: int) -> StoredSample:
        file, message = self._samples[index]
        try:
            return decode_sample(file.content(message), self._stated_sensor)
        except DatasetError as err:
            raise FileError(file.path, str(err), field=f"sample at byte {message.offset}") from err

    def message_counts(self) -> dict[str, dict[str, Any]]:
        """Return the message counts by topic, summed over the last ones of each recording."""
        total = MessageCounts()
        for file in self._files:
            total.add(file.counts or MessageCounts())
        return total.to_record()

    def name(self, index: int) -> str:
        """Return file and offset of a sample, for messages; in a compressed chunk also that in its content."""
        file, message = self._samples[index]
        inside = f"+{message.start}" if message.chunk else ""
        return f"{file.path}[{message.offset}{inside}]"


def recognise(path: Path) -> bool:
    """Return whether a path is a recorded dataset, or an MCAP file that foretouch recorded."""
    if path.is_dir():
        return is_dataset(path)
    if path.suffix != ".mcap" or not path.is_file():
        return False
    with open_regular(path) as file:
        start = file.read(100)
    return start.startswith(MAGIC) and b"foretouch " in start  # the name of the library in the header


def open_set(path: Path, unfinished: bool) -> SampleSet:
    """Return the samples of a recorded dataset; a `FileError` names file and position of damage."""
    dataset = RecordedDataset(path)
    cut = tuple(dataset.unfinished)
    if cut and not unfinished:
        raise FileError(cut[0], "is not finished: run `foretouch dataset repair`")
    return SampleSet(
        path=path,
        kind="recording",
        size=len(dataset),
        read=dataset.__getitem__,
        name=dataset.name,
        identity=dataset.identity,
        unfinished=cut,
        message_counts=dataset.message_counts,
        edits=tuple(dataset.edits.descriptions()),
        sensor=dataset.sensor,
    )


def samples_in(file: RecordingFile) -> list[RecordedMessage]:
    """Return the messages with samples in a file, in order, up to its end or to where it is cut off.

    Raises a `FileError` at the first invalid sample, unless the file merely ends within it, and if a finished file holds
    another number of samples than it counts.
    """
    for only in (SAMPLE_TYPES, ()):  # other tools may have put samples into chunks behind other messages
        messages = []
        for item in file.messages(only):
            if isinstance(item, RecordedMessage):
                if item.type in SAMPLE_TYPES:
                    messages.append(item)
            elif not file.finished and (item.rule.startswith("cut off") or len(file.data) < len(MAGIC)):
                break
            else:
                raise item.error(file.path)
        counted = (file.counts or MessageCounts()).topics.get(SAMPLE_TOPIC, TopicCounts()).written
        if not file.finished or counted == len(messages):
            return messages
    raise FileError(file.path, f"damaged: holds {len(messages)} samples, and counts {counted}", field="samples")


def readable(file: RecordingFile, message: RecordedMessage) -> StoredSample | None:
    """Return the sample in a message, None if it is none or incomplete; a `VersionError` if it is of another version."""
    try:
        return decode_sample(file.content(message))
    except VersionError:
        raise
    except DatasetError:
        return None


def recorded_ids(path: Path) -> set[str]:
    """Return the ids in a dataset, including those after damage that `repair` would save; a `FileError` for damage of a finished file."""
    ids = set()
    for session in session_files(path):
        file = RecordingFile(session)
        for item in samples_in(file) if file.finished else file.messages():
            stored = None if isinstance(item, Damage) else readable(file, item)
            if stored is not None:
                ids.add(stored.sample.id)
            elif file.finished:
                raise FileError(session, "holds a damaged sample: run `foretouch dataset repair`")
    return ids


def known_sessions(path: Path) -> dict[str, str]:
    """Return the ids of the sessions in a dataset by file: those that the manifest states, and of others what is in the file."""
    known: dict[str, str] = stated(path, SESSIONS)
    for session in session_files(path):
        if session.name not in known:
            known[session.name] = session_id(session)
    return known


def session_id(path: Path) -> str:
    """Return the id in a session; "" if it has none, as before 0.4."""
    file = RecordingFile(path)
    next(file.messages(only=SAMPLE_TYPES), None)
    return file.metadata.get(ABOUT, {}).get("id", "")
