# SPDX-License-Identifier: Apache-2.0
"""Sources of clouds: a file, a folder of files, a dataset in any readable format, or a recording.

`open_source` finds out which. Every entry becomes one `SourceItem`, in order; an entry that cannot be read raises when
its cloud is requested, so that one bad file costs one item.
"""

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Literal

from foretouch.cloud.io.files import CLOUD_SUFFIXES, read_cloud
from foretouch.dataset.bag import RECORDING_SUFFIXES, Message, Recording, is_recording
from foretouch.dataset.formats import readable_formats
from foretouch.dataset.samples import SampleSet, is_sample_set, open_samples
from foretouch.errors import FileError
from foretouch.files import require_existing
from foretouch.types import Cloud, GraspSample

#: Stamp of the k-th cloud of a folder over k, from 1 [ns]: most files carry none, and stamps must rise.
STAMP_STEP_NS = 100_000_000


@dataclass(eq=False)
class SourceItem:
    """One entry of a source, read on request."""

    name: str  # its file or folder, or recording and number of the message
    load: Callable[[], Cloud | GraspSample]

    @cached_property
    def _value(self) -> Cloud | GraspSample:
        return self.load()

    @property
    def cloud(self) -> Cloud:
        """The cloud, or that of the sample; a `ForetouchError` if it cannot be read."""
        return self._value.cloud if isinstance(self._value, GraspSample) else self._value

    @property
    def sample(self) -> GraspSample | None:
        """The sample; None for a cloud alone (raises as `cloud`)."""
        return self._value if isinstance(self._value, GraspSample) else None


@dataclass(frozen=True)
class Source:
    """The clouds at a path in order; can be iterated repeatedly."""

    path: Path  # as given
    kind: Literal["clouds", "samples", "recording"]  # what was found there
    topic: str | None = None  # the topic of a recording, else None
    frame_id: str = ""  # for clouds without a frame
    entries: tuple[Path, ...] = ()  # the cloud files, in order; empty for a recording and for a dataset
    count: int = 0  # number of entries, or of messages that the recording declares

    def __len__(self) -> int:
        return self.count

    def __iter__(self) -> Iterator[SourceItem]:
        if self.kind == "recording":
            yield from self._recorded()
        elif self.kind == "samples":
            yield from self._samples()
        else:
            for number, entry in enumerate(self.entries, 1):
                yield SourceItem(str(entry), partial(self._load_cloud, entry, number * STAMP_STEP_NS))

    def _load_cloud(self, entry: Path, stamp_ns: int) -> Cloud:
        return self._stamped(read_cloud(entry), stamp_ns)

    def _load_sample(self, samples: SampleSet, index: int, stamp_ns: int) -> GraspSample:
        sample = samples.record(index).sample
        return replace(sample, cloud=self._stamped(sample.cloud, stamp_ns))

    def _stamped(self, cloud: Cloud, stamp_ns: int) -> Cloud:
        return replace(cloud, stamp_ns=stamp_ns, frame_id=cloud.frame_id or self.frame_id)

    def _samples(self) -> Iterator[SourceItem]:
        samples = open_samples(self.path)
        names = [samples.name(k) for k in range(len(samples))]
        for number, k in enumerate(sorted(range(len(names)), key=lambda k: _natural(names[k])), 1):
            yield SourceItem(names[k], partial(self._load_sample, samples, k, number * STAMP_STEP_NS))

    def _recorded(self) -> Iterator[SourceItem]:
        with Recording(self.path) as recording:
            for message in recording.messages([recording.cloud_topic(self.topic)]):
                yield SourceItem(f"{self.path}[{message.index}]", partial(self._decode, recording, message))

    def _decode(self, recording: Recording, message: Message) -> Cloud:
        cloud = recording.decode_cloud(message)
        return cloud if cloud.frame_id else replace(cloud, frame_id=self.frame_id)


def open_source(path: str | Path, topic: str | None = None, *, frame_id: str = "") -> Source:
    """Find out what is at a path.

    Args:
        path: A cloud file, a folder of such files, a dataset in any readable format, or a recording of other topics
            (see `foretouch.dataset.bag.Recording`).
        topic: The topic of a recording that holds several topics of clouds; for a recorded dataset, the topic to read
            instead of its samples.
        frame_id: For clouds without a frame.

    Returns:
        A `Source`. Files are in natural order (`2.pcd` before `10.pcd`) and stamped by their index; the clouds of a
        recording keep frame and stamp.

    Raises:
        FileError: If the path does not exist or its format is unknown, or a topic is given for files.
    """
    path = require_existing(path)
    if topic is None and is_sample_set(path):
        return Source(path, "samples", None, frame_id, (), len(open_samples(path)))
    if is_recording(path):
        with Recording(path) as recording:
            topic = recording.cloud_topic(topic)
            count = next(t.count for t in recording.topics if t.name == topic)
        return Source(path, "recording", topic, frame_id, (), count)
    if topic is not None:
        raise FileError(path, f"is not a recording, so it has no topic {topic}")
    if not path.is_dir():
        if path.suffix.lower() not in CLOUD_SUFFIXES:
            known = ", ".join(CLOUD_SUFFIXES + RECORDING_SUFFIXES)
            raise FileError(path, f"suffix {path.suffix or 'absent'} is not one of {known}")
        return Source(path, "clouds", None, frame_id, (path,), 1)
    entries = tuple(sorted((p for p in path.iterdir() if p.suffix.lower() in CLOUD_SUFFIXES), key=_natural))
    if not entries:
        known = ", ".join(CLOUD_SUFFIXES)
        raise FileError(path, f"holds no clouds ({known}), no recording and no dataset ({readable_formats()})")
    return Source(path, "clouds", None, frame_id, entries, len(entries))


def _natural(name: str | Path) -> list[tuple[int, int | str]]:
    """Sort key that puts `2.pcd` before `10.pcd`."""
    return [(0, int(word)) if word.isdecimal() else (1, word) for word in re.split(r"(\d+)", str(name))]
