# SPDX-License-Identifier: Apache-2.0
"""Reads the samples of a recorded dataset, in the order of their recording.

The offsets of the samples are found without decoding other messages (see `scan`). A recording that was cut off is read as
far as it is intact.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from mcap.records import Metadata

from foretouch.dataset.record import Identity
from foretouch.dataset.recording.edits import EditLog, read_edits
from foretouch.dataset.recording.folder import is_dataset, recorded_files, recorded_sensor
from foretouch.dataset.recording.records import (
    MAGIC,
    Declarations,
    MessageCounts,
    Record,
    RecordedMessage,
    declared_samples,
    is_finished,
    walk,
)
from foretouch.dataset.recording.sample_codec import ABOUT, SAMPLE_TYPES, StoredSample, decode_sample
from foretouch.dataset.recording.scan import require_intact, sample_messages
from foretouch.dataset.recording.verify import require_chain
from foretouch.dataset.samples import SampleSet
from foretouch.errors import DatasetError, FileError
from foretouch.files import FileBytes, open_regular
from foretouch.tactile.channels import BIOTAC_SP


class RecordedDataset:
    """The samples of a recorded dataset, or of one of its `.mcap` files.

    One of version 1 is only read to `convert` it. A `FileError` names file and position if the path is not a recorded dataset, or a
    manifest or recording is damaged.
    """

    def __init__(self, path: str | Path, *, convert: bool = False) -> None:
        self.path = Path(path)
        self._convert = convert
        self.files = recorded_files(self.path, convert=convert)  # MCAP files
        if self.path.is_dir():
            require_chain(self.path)
        self.stated_sensor = recorded_sensor(self.path) if self.path.is_dir() else None  # by the manifest
        self.edits = read_edits(self.path) if self.path.is_dir() else EditLog()  # which are applied to the samples
        self._samples: list[tuple[FileBytes, RecordedMessage]] = []
        self._declared: list[Declarations] = []  # by file
        self.unfinished: list[Path] = []  # files that were cut off; they are read as far as they are intact
        for file in self.files:
            data, declared = FileBytes(file), Declarations()
            found = [(data, one) for one in sample_messages(file, data, declared)]
            if is_finished(data):
                _check_count(file, data, len(found))
            else:
                self.unfinished.append(file)
            self._samples += found
            self._declared.append(declared)

    def __len__(self) -> int:
        return len(self._samples)

    def __getitem__(self, index: int) -> StoredSample:
        """One sample with the edits applied, verified by its SHA-256; a `FileError` names the position of damage."""
        stored = self.as_recorded(index)
        return stored._replace(record=self.edits.apply(stored.record))

    def __iter__(self) -> Iterator[StoredSample]:
        for k in range(len(self)):
            yield self[k]

    def as_recorded(self, index: int) -> StoredSample:
        """One sample before any edit (raises as indexing)."""
        data, message = self._samples[index]
        try:
            return decode_sample(data[message.start : message.end], self.stated_sensor, convert=self._convert)
        except DatasetError as err:
            raise FileError(data.path, str(err), field=f"sample at byte {message.start}") from err

    def message_counts(self) -> dict[str, dict[str, Any]]:
        """The message counts by topic, summed over the last ones of each recording; a `FileError` for damage."""
        total = MessageCounts()
        for file, declared in zip(self.files, self._declared, strict=True):
            require_intact(file, declared.damage)
            total.add(declared.counts or MessageCounts())
        return total.to_record()

    def name(self, index: int) -> str:
        """File and offset of a sample, for messages."""
        data, message = self._samples[index]
        return f"{data.path}[{message.start}]"


def _check_count(path: Path, data: FileBytes, found: int) -> None:
    """Compare the samples found in a finished file with the count in its summary, which has a checksum."""
    count = require_intact(path, declared_samples(data))
    if count != found:
        raise FileError(path, f"damaged: holds {found} samples, its index declares {count}", field="samples")


def recognise(path: Path) -> bool:
    """Whether a path is a recorded dataset, or an MCAP file that begins as a recording of foretouch."""
    if path.is_dir():
        return is_dataset(path)
    if path.suffix != ".mcap" or not path.is_file():
        return False
    with open_regular(path) as file:
        start = file.read(65536)
    contents = (record.content for record in walk(start) if isinstance(record, Record))
    begins = any(isinstance(content, Metadata) and content.name == ABOUT for content in contents)
    return start.startswith(MAGIC) and (begins or any(name.encode() in start for name in SAMPLE_TYPES))


def convert(path: Path) -> SampleSet:
    """The samples of a recorded dataset, also of version 1."""
    return open_set(path, unfinished=False, old=True)


def open_set(path: Path, unfinished: bool, *, old: bool = False) -> SampleSet:
    """The samples of a recorded dataset, also of version 1 if `old` is true (raises as `RecordedDataset`)."""
    dataset = RecordedDataset(path, convert=old)
    cut = tuple(dataset.unfinished)
    if cut and not unfinished:
        raise FileError(cut[0], "is not finished: run `foretouch dataset repair`")
    first = dataset[0] if len(dataset) else None
    return SampleSet(
        path=path,
        kind="recording",
        size=len(dataset),
        record=lambda k: dataset[k].record,
        name=dataset.name,
        identity=first.identity if first else Identity(),
        unfinished=cut,
        message_counts=dataset.message_counts,
        edits=tuple(dataset.edits.descriptions()),
        sensor=dataset.stated_sensor or (first.sensor if first else BIOTAC_SP),
    )
