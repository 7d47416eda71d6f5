# SPDX-License-Identifier: Apache-2.0
"""Sources of clouds: a file, a folder of files, a dataset in any readable format, or a recording.

`open_source` finds out which. Every entry becomes one `SourceItem`, in order; an entry that cannot be read raises when
its cloud is requested, so that one bad file costs one item.
"""

import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Literal

from foretouch.base.files import require_existing
from foretouch.cloud.io.colours import COLOUR_SUFFIXES
from foretouch.cloud.io.depth_files import PAIRING, DepthCamera, Pairs
from foretouch.cloud.io.files import CLOUD_SUFFIXES, holds_points, read_cloud
from foretouch.cloud.io.images import IMAGE_SUFFIXES
from foretouch.dataset.formats import is_sample_set, open_samples, readable_formats
from foretouch.dataset.recordings.bag import RECORDING_SUFFIXES, Recording, Topic, is_recording
from foretouch.errors import FileError
from foretouch.types import Cloud, Sample

#: Stamp of the k-th cloud of a folder over k, from 1 [ns]: most files carry none, and stamps must rise.
STAMP_STEP_NS = 100_000_000


@dataclass(eq=False)
class SourceItem:
    """One entry of a source, read on request."""

    name: str  # its file or folder, or recording and number of the message
    load: Callable[[], Cloud | Sample]
    mask: Path | None = None  # of a depth image in a folder
    place: int | None = None  # of a cloud among those of the camera of a recording, from 0; None of files and samples

    @cached_property
    def _value(self) -> Cloud | Sample:
        return self.load()

    @property
    def cloud(self) -> Cloud:
        """The cloud, or the cloud of the sample; a `ForetouchError` if it cannot be read."""
        return self._value.cloud if isinstance(self._value, Sample) else self._value

    @property
    def sample(self) -> Sample | None:
        """The sample; None for a cloud alone. A `ForetouchError` if it cannot be read."""
        return self._value if isinstance(self._value, Sample) else None


@dataclass(frozen=True)
class Source:
    """The clouds at a path in order; can be iterated repeatedly."""

    path: Path  # as given
    kind: Literal["clouds", "samples", "recording"]  # what was found there
    count: int  # number of entries, or of messages that the recording declares
    entries: Callable[[], Iterable[tuple[str, Callable[[], Cloud | Sample]]]]  # name of each, and what reads it
    frame_id: str = ""  # for clouds without a frame
    topic: str = ""  # of the clouds or depth images of a recording
    color_topic: str = ""  # of the colours of depth images of a recording
    info_topic: str = ""  # of the camera infos of depth images that are played as they are; "" for clouds
    converted: bool = (
        False  # whether the depth images of a recording become clouds, since nodes would read them otherwise
    )
    others: tuple[Topic, ...] = ()  # further topics of a recording
    masks: Mapping[str, Path] = field(default_factory=dict)  # of depth images of a folder, by name of the entry
    camera: DepthCamera = DepthCamera()  # what is known besides of the depth images of a recording
    remarks: list[str] = field(default_factory=list)  # at the end of an iteration: images without colours, odd cameras
    notes: tuple[str, ...] = ()  # what its `metadata.yaml` states otherwise than its files, and images left out

    def __len__(self) -> int:
        return self.count

    def __iter__(self) -> Iterator[SourceItem]:
        for number, (name, load) in enumerate(self.entries()):
            recorded = self.kind == "recording"
            load_stamped = partial(self._load, load, None if recorded else (number + 1) * STAMP_STEP_NS)
            yield SourceItem(name, load_stamped, self.masks.get(name), number if recorded else None)

    def _load(self, load: Callable[[], Cloud | Sample], stamp_ns: int | None) -> Cloud | Sample:
        loaded = load()
        if isinstance(loaded, Sample):
            return replace(loaded, cloud=self._stamped(loaded.cloud, stamp_ns))
        return self._stamped(loaded, stamp_ns)

    def _stamped(self, cloud: Cloud, stamp_ns: int | None) -> Cloud:
        stamp_ns = cloud.stamp_ns if stamp_ns is None else stamp_ns
        return replace(cloud, stamp_ns=stamp_ns, frame_id=cloud.frame_id or self.frame_id)


def open_source(
    path: str | Path, topic: str | None = None, *, frame_id: str = "", camera: DepthCamera | None = None
) -> Source:
    """Find out what is at a path.

    Args:
        path: A cloud file, a folder of such files, a dataset in any readable format, or a recording of other topics
            (see `foretouch.dataset.recordings.bag.Recording`).
        topic: The topic of a recording that holds several topics of clouds; for a recorded dataset, the topic to read
            instead of its samples.
        frame_id: For clouds without a frame.
        camera: Of depth images; goes before what their folder or recording states.

    Returns:
        A `Source`. Files are in natural order (`2.pcd` before `10.pcd`) and stamped by their index; the clouds of a
        recording keep frame and stamp.

    Raises:
        FileError: If the path does not exist or its format is unknown, a topic is given for files, or `camera` states what
            the source has no use for.
    """
    path, camera = require_existing(path), camera or DepthCamera()
    if topic is None and is_sample_set(path):
        camera.require_none(path, "is a dataset, whose clouds are stored")
        samples = open_samples(path)
        numbers = sorted(range(len(samples)), key=lambda k: _natural(samples.name(k)))
        named = [(samples.name(k), partial(samples.read, k)) for k in numbers]
        return Source(path, "samples", len(named), partial(list, named), frame_id)
    if is_recording(path):
        return _recording(path, topic, frame_id, camera)
    for name in filter(None, (topic, camera.info_topic)):
        raise FileError(path, f"is not a recording, so it has no topic {name}")
    return _clouds(path, frame_id, camera)


def _recording(path: Path, topic: str | None, frame_id: str, camera: DepthCamera) -> Source:
    """Return the clouds of a recording as a source."""
    with Recording(path, camera) as recording:
        name = recording.cloud_topic(topic)
        topics = {recorded.name: recorded for recorded in recording.topics}
        count = topics.pop(name).count
        info, converted, colours = recording.info_topic(name), recording.is_converted(name), recording.color_topic(name)
        notes = recording.notes
    remarks: list[str] = []
    return Source(
        path,
        "recording",
        count,
        partial(_recorded, path, name, camera, remarks),
        frame_id,
        name,
        color_topic=colours,
        info_topic="" if converted else info,
        converted=converted,
        others=tuple(topics.values()),
        camera=camera,
        remarks=remarks,
        notes=notes,
    )


def _clouds(path: Path, frame_id: str, given: DepthCamera) -> Source:
    """Return a file, or the files of a folder, as a source of clouds."""
    is_folder = path.is_dir()
    if given.stated and not is_folder and holds_points(path):
        given.require_none(path, "holds points")
    if given.color and is_folder:
        raise FileError(path, "is a folder, whose colours are NAME-color.png beside NAME-depth.png: leave out --color")
    files = sorted(path.iterdir(), key=_natural) if is_folder else [path]
    pairs = Pairs.of(files if is_folder else [])
    known = CLOUD_SUFFIXES if is_folder else CLOUD_SUFFIXES + IMAGE_SUFFIXES
    clouds, left_out = [], []
    for file in files:
        if file in pairs.depths or (file.suffix.lower() in known and file not in pairs.others):
            beside = None if given.info or given.intrinsics else pairs.infos.get(file)
            own = replace(given, info=given.info or beside, color=given.color or pairs.colours.get(file, ""))
            clouds.append((str(file), partial(read_cloud, file, own)))
        elif file.suffix.lower() in (*IMAGE_SUFFIXES, *COLOUR_SUFFIXES) and file not in pairs.others:
            left_out.append(file.name)
    if not clouds and is_folder:
        formats = ", ".join(CLOUD_SUFFIXES)
        rule = f"holds no clouds ({formats}), no depth images, no recording and no dataset ({readable_formats()}); {PAIRING}"
        raise FileError(path, rule)
    if not clouds:
        formats = ", ".join(known + RECORDING_SUFFIXES)
        raise FileError(path, f"the extension is not one of {formats}")
    more = f" and {len(left_out) - 1} more" if left_out[1:] else ""
    rule = "a depth image in a folder is NAME-depth or depth-NAME"
    notes = (f"{path}: left out: {left_out[0]}{more}; {rule}",) if left_out else ()
    masks = {str(file): mask for file, mask in pairs.masks.items()}
    return Source(
        path, "clouds", len(clouds), partial(list, clouds), frame_id, masks=masks, notes=notes, remarks=given.remarks
    )


def _recorded(
    path: Path, topic: str, camera: DepthCamera, remarks: list[str]
) -> Iterator[tuple[str, Callable[[], Cloud]]]:
    with Recording(path, camera) as recording:
        for message, decode in recording.clouds(topic):
            yield f"{path}[{message.index}]", decode
        remarks[:] = recording.remarks(topic)


def _natural(name: str | Path) -> list[tuple[int, int | str]]:
    """Make a sort key that puts `2.pcd` before `10.pcd`."""
    return [(0, int(word)) if word.isdecimal() else (1, word) for word in re.split(r"(\d+)", str(name))]
