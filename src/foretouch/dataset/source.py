# SPDX-License-Identifier: Apache-2.0
"""Where clouds come from: a file, a folder of files or of grasp samples, a dataset of samples, a recording.

`open_source` decides which by what lies at the path. Every entry becomes one `SourceItem`, in
order; an entry that cannot be read is an item too, and tells why when its cloud is asked for, so
that one bad file costs one item.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from foretouch.cloud.io.files import CLOUD_SUFFIXES, read_cloud
from foretouch.dataset.bag import RECORDING_SUFFIXES, Message, Recording, is_recording
from foretouch.dataset.vision2tactile import is_sample_folder, read_sample, sample_folders
from foretouch.errors import FileError, ForetouchError
from foretouch.types import Cloud, GraspSample

if TYPE_CHECKING:
    from foretouch.dataset.samples import SampleSet

__all__ = ["STAMP_STEP_NS", "Source", "SourceItem", "SourceKind", "open_source", "readable"]

STAMP_STEP_NS = 100_000_000
"""The k-th cloud of a folder, from 1, gets k times this [ns]: most files carry no stamp, and stamps must rise."""

SourceKind = Literal["clouds", "samples", "recording"]


class SourceItem:
    """One entry of a source, read when it is asked for.

    Attributes:
        name: The file or folder it comes from; for a recording, its path and the number of the message.
    """

    def __init__(self, name: str, load: Callable[[], Cloud | GraspSample]) -> None:
        self.name = name
        self._load = load

    @cached_property
    def value(self) -> Cloud | GraspSample:
        """What the entry holds.

        Raises:
            ForetouchError: If it cannot be read.
        """
        return self._load()

    @property
    def cloud(self) -> Cloud:
        """The cloud, be it alone or a sample's (raises as `value`)."""
        return self.value.cloud if isinstance(self.value, GraspSample) else self.value

    @property
    def sample(self) -> GraspSample | None:
        """The sample; None for a cloud alone (raises as `value`)."""
        return self.value if isinstance(self.value, GraspSample) else None


@dataclass(frozen=True)
class Source:
    """An ordered, repeatable walk over the clouds at a path.

    Attributes:
        path: As given.
        kind: What was found there.
        topic: Of a recording; None elsewhere.
        frame_id: For clouds that name no frame of their own.
        entries: The files or sample folders, in order; empty for a recording and for a dataset.
        count: Number of entries, or of messages that the recording declares.
    """

    path: Path
    kind: SourceKind
    topic: str | None = None
    frame_id: str = ""
    entries: tuple[Path, ...] = ()
    count: int = 0

    @property
    def segmented(self) -> bool:
        """Whether each cloud holds one object and nothing else, so far as the kind tells."""
        return self.kind == "samples"

    def __len__(self) -> int:
        return self.count

    def __iter__(self) -> Iterator[SourceItem]:
        if self.kind == "recording":
            yield from self._recorded()
            return
        if self.kind == "samples" and not self.entries:
            yield from self._sampled()
            return
        read = read_sample if self.kind == "samples" else read_cloud
        for number, entry in enumerate(self.entries, 1):
            yield SourceItem(str(entry), self._reader(read, entry, number * STAMP_STEP_NS))

    def _reader(
        self, read: Callable[[Path], Cloud | GraspSample], entry: Path, stamp_ns: int
    ) -> Callable[[], Cloud | GraspSample]:
        return lambda: self._placed(read(entry), stamp_ns)

    def _placed(self, value: Cloud | GraspSample, stamp_ns: int) -> Cloud | GraspSample:
        """With the stamp, and a frame if it has none."""
        cloud = value.cloud if isinstance(value, GraspSample) else value
        cloud = replace(cloud, stamp_ns=stamp_ns, frame_id=cloud.frame_id or self.frame_id)
        return replace(value, cloud=cloud) if isinstance(value, GraspSample) else cloud

    def _sampled(self) -> Iterator[SourceItem]:
        from foretouch.dataset.samples import open_samples

        with open_samples(self.path) as samples:
            for k in range(len(samples)):
                yield SourceItem(samples.name(k), self._sample_reader(samples, k))

    def _sample_reader(self, samples: SampleSet, k: int) -> Callable[[], Cloud | GraspSample]:
        return lambda: self._placed(samples.record(k).sample, (k + 1) * STAMP_STEP_NS)

    def _recorded(self) -> Iterator[SourceItem]:
        with Recording(self.path) as recording:
            for message in recording.messages([recording.cloud_topic(self.topic)]):
                yield SourceItem(f"{self.path}[{message.index}]", self._decoder(recording, message))

    def _decoder(self, recording: Recording, message: Message) -> Callable[[], Cloud]:
        def decode() -> Cloud:
            cloud = recording.decode_cloud(message)
            return cloud if cloud.frame_id else replace(cloud, frame_id=self.frame_id)

        return decode


def open_source(path: str | Path, topic: str | None = None, *, frame_id: str = "") -> Source:
    """Find out what lies at a path.

    Args:
        path: A cloud file, a folder of such files, a folder of vision2tactile samples (one, one object's, or
            of several objects), a recorded dataset or one of its files, a training store, or a recording of
            other topics (see `foretouch.dataset.bag.Recording`).
        topic: Of a recording that holds several topics of clouds; of a recorded dataset, to take that topic
            instead of its samples.
        frame_id: For clouds that name no frame of their own.

    Returns:
        A `Source`. Files are in natural order (`2.pcd` before `10.pcd`) and stamped by their place in it; the
        clouds of a recording keep frame and stamp.

    Raises:
        FileError: If there is nothing at the path, or nothing that is known, or a topic is given for files.
    """
    path = Path(path)
    if not path.exists():
        raise FileError(path, "does not exist")
    if topic is None and _may_hold_samples(path):
        from foretouch.dataset.samples import open_samples

        with open_samples(path) as samples:
            return Source(path, "samples", None, frame_id, (), len(samples))
    if is_recording(path):
        return _open_recording(path, topic, frame_id)
    if topic is not None:
        raise FileError(path, f"is no recording, so it has no topic {topic}")
    if path.is_dir():
        return _open_folder(path, frame_id)
    if path.suffix.lower() not in CLOUD_SUFFIXES:
        known = ", ".join(CLOUD_SUFFIXES + RECORDING_SUFFIXES)
        raise FileError(path, f"suffix {path.suffix or 'absent'} is none of {known}")
    return Source(path, "clouds", None, frame_id, (path,), 1)


def readable(
    source: Source, refuse: Callable[[str, ForetouchError], None]
) -> Iterator[tuple[str, Cloud | GraspSample]]:
    """What can be read, by name.

    Args:
        source: Of clouds or samples.
        refuse: Called with name and error for each item that cannot; a recording that breaks off ends the walk.
    """
    items = iter(source)
    while True:
        name = str(source.path)
        try:
            item = next(items, None)
            if item is None:
                return
            name = item.name
            value = item.value
        except ForetouchError as err:
            refuse(name, err)
            continue
        yield name, value


def _may_hold_samples(path: Path) -> bool:
    """Whether a dataset or a store lies there; asked without loading what reads them."""
    if path.is_dir():
        return (path / "manifest.json").is_file()
    if path.suffix != ".mcap":
        return False
    from foretouch.dataset.recording.reader import holds_samples

    return holds_samples(path)


def _open_recording(path: Path, topic: str | None, frame_id: str) -> Source:
    with Recording(path) as recording:
        chosen = recording.cloud_topic(topic)
        count = next(t.count for t in recording.topics if t.name == chosen)
    return Source(path, "recording", chosen, frame_id, (), count)


def _open_folder(path: Path, frame_id: str) -> Source:
    nested = (folder for pattern in ("*", "*/*") for folder in path.glob(pattern))
    if is_sample_folder(path) or any(is_sample_folder(folder) for folder in nested):
        entries = tuple(sorted(sample_folders(path), key=_natural))
        return Source(path, "samples", None, frame_id, entries, len(entries))
    entries = tuple(sorted((p for p in path.iterdir() if p.suffix.lower() in CLOUD_SUFFIXES), key=_natural))
    if not entries:
        known = ", ".join(CLOUD_SUFFIXES)
        raise FileError(path, f"holds no clouds ({known}), no grasp samples (cloud-object.pcd) and no recording")
    return Source(path, "clouds", None, frame_id, entries, len(entries))


def _natural(path: Path) -> list[tuple[int, int | str]]:
    """Sort key by which `2.pcd` stands before `10.pcd`."""
    words = re.split(r"(\d+)", str(path))
    return [(0, int(word)) if word.isdecimal() else (1, word) for word in words]
