# SPDX-License-Identifier: Apache-2.0
"""Reads ROS recordings without ROS: rosbag2 directories (MCAP, SQLite), bare files, ROS 1 bags.

`rosbags` reads SQLite, ROS 1 bags and message definitions, `McapReader` MCAP files, also where an index or their end is
missing. What a `metadata.yaml` states is compared with the files, which decide. `Recording` returns the messages as they
were recorded, for replay, and the clouds in them. For writing see `foretouch.dataset.formats.rosbag2`.
"""

from __future__ import annotations

import re
from collections import Counter, deque
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import ExitStack, suppress
from copy import deepcopy
from dataclasses import dataclass
from functools import cache, lru_cache, partial
from heapq import merge
from itertools import islice
from operator import itemgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Self

from foretouch.base.files import open_regular, require_existing
from foretouch.cloud.io.colours import COLOUR_ENCODINGS, ColourImages, colours_of
from foretouch.cloud.io.depth_files import DepthCamera
from foretouch.cloud.io.depth_messages import ENCODINGS, CameraInfos, decode_depth, info_topic
from foretouch.cloud.messages import decode_cloud, read_header
from foretouch.config import load_yaml
from foretouch.dataset.recordings.bag_files import PACKED, McapStorage, known_failures, open_storage, plain
from foretouch.errors import CloudError, DatasetError, FileError, ForetouchError, none_of
from foretouch.types import Cloud, UInt8, stamp_ns

if TYPE_CHECKING:
    from rosbags.interfaces import Connection, MessageDefinition
    from rosbags.interfaces.typing import Typesdict
    from rosbags.typesys.store import Typestore


POINT_CLOUD_TYPE = "sensor_msgs/msg/PointCloud2"
_IMAGE_TYPE = "sensor_msgs/msg/Image"
_COMPRESSED_TYPE = "sensor_msgs/msg/CompressedImage"
_IMAGE_TYPES = (_IMAGE_TYPE, _COMPRESSED_TYPE)
_CAMERA_INFO_TYPE = "sensor_msgs/msg/CameraInfo"
_HEADER_TYPE = "std_msgs/msg/Header"
RECORDING_SUFFIXES = (".mcap", ".db3", ".bag")
_PACKED_SUFFIXES: Final = (f".mcap{PACKED}", f".db3{PACKED}")
_METADATA: Final = "metadata.yaml"
_VIEWER: Final = re.compile(r"(/device_\d+/sensor_\d+)/(\w+)/image/data")  # images in recordings of librealsense
_WAIT_NS: Final = 100_000_000  # recorded time for which a depth image is held back for its colours, as in a node
_TAXELS = "/foretouch/taxels/"  # clouds that are no camera's, in recordings of foretouch 0.3 and older


@dataclass(frozen=True)
class Topic:
    """One topic of a recording."""

    name: str  # as recorded
    type: str  # ROS 2 name of its messages, such as `sensor_msgs/msg/PointCloud2`; "" where publishers disagreed
    count: int  # number of messages that the recording declares
    fields: tuple[str, ...] = ()  # of the message, in serialised order; empty if the recording has no definition
    stamped: bool = False  # whether the message begins with a `std_msgs/Header`
    latched: bool = False  # whether late subscribers receive the last message (transient local)


@dataclass(frozen=True, eq=False)
class Message:
    """One recorded message."""

    topic: str  # its topic
    type: str  # ROS 2 name of its type
    index: int  # its index among the messages of its topic, from 0
    bag_time_ns: int  # when the recorder received it [ns]; independent of the stamp in its header
    data: bytes  # CDR with its encapsulation header, as `rclpy` publishes it
    definition: tuple[Any, str, bool]  # of its type


class Recording:
    """An open recording; a context manager. Each thread and each process opens its own.

    Args:
        path: A rosbag2 directory, a directory of `.mcap` or `.db3` files, such a file, or a ROS 1 `.bag`.
        camera: What is known of the camera of its depth images; it goes before what is recorded.

    Attributes:
        topics: What it holds; of an MCAP file without an index, as far as it is intact.
        notes: Where its `metadata.yaml` states something else than is in the files, one line each.
        colours: Of the depth images, and what became of them.

    Raises:
        FileError: If the path is not a recording, or is truncated or damaged. An MCAP file is read as far as it is intact.
    """

    def __init__(self, path: str | Path, camera: DepthCamera | None = None) -> None:
        self.path = Path(path)
        self._camera = camera or DepthCamera()
        self._info_of, self._colours_of = cache(self._find_info), cache(self._find_colours)
        self.colours = ColourImages()
        files = _storage_files(self.path)
        with ExitStack() as stack:
            self._readers = [open_storage(file, stack) for file in files]
            with known_failures(self.path):
                self._connections = [connection for reader in self._readers for connection in reader.connections]
                self.topics: tuple[Topic, ...] = tuple(self._topics())
            if not self.topics:
                next(self.messages(), None)  # of a file that is cut off before its first message
            self.notes = tuple(_contradictions(self.path, files, self.topics))
            self._stack = stack.pop_all()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the files; may be called more than once."""
        self._stack.close()

    def cloud_topic(self, topic: str | None = None) -> str:
        """Find the topic of the clouds or depth images.

        Args:
            topic: The topic, which is checked; None for the only one. A topic of clouds is preferred to depth images, and
                an image to the compressed form of it.

        Raises:
            FileError: If the topic is absent, holds other messages or none, has no camera info, or if several qualify.
        """
        named = [
            t for t in self.topics if t.count and (t.name == topic or (not topic and not t.name.startswith(_TAXELS)))
        ]
        qualified = [t for t in named if t.type == POINT_CLOUD_TYPE]
        if not qualified:
            qualified = _images_first(filter(self._is_depth, named))
        if len(qualified) != 1:
            rule = "several topics of clouds or depth images, name one with --topic"
            if not qualified:
                rule = f"no messages of {POINT_CLOUD_TYPE}, nor depth images ({', '.join(ENCODINGS)}, compressedDepth)"
            raise FileError(self.path, f"{rule}: {_listed(qualified or self.topics)}", field=topic)
        name = qualified[0].name
        if qualified[0].type == POINT_CLOUD_TYPE:
            self._camera.require_none(self.path, f"{name} holds clouds of points")
        elif not self._camera.is_known and not self.info_topic(name):
            rule = f"depth images need their camera info, and {info_topic(name)} is absent: record it too, or give"
            others = ", ".join(self._infos()) or "none"
            cure = f"{rule} --info-topic (there are: {others}), --camera-info or --intrinsics"
            raise FileError(self.path, cure, field=name)
        return name

    def _is_depth(self, topic: Topic) -> bool:
        if topic.type == _COMPRESSED_TYPE:
            return topic.name.endswith("/compressedDepth")
        if topic.type != _IMAGE_TYPE:
            return False
        try:
            return self._first(topic.name).encoding in ENCODINGS
        except (FileError, StopIteration):
            return False

    def info_topic(self, topic: str) -> str:
        """Find the topic of the camera infos of depth images.

        It is the given one, `camera_info` beside the images, librealsense's name, or the only one whose first info is of the
        frame and size of the first image; "" for clouds, or where there is none.

        Raises:
            FileError: If the given one is absent, or holds other messages or none.
        """
        return self._info_of(topic)

    def color_topic(self, topic: str) -> str:
        """Find the topic of the colours of depth images.

        It is the given one, or the only one whose first image is of the frame and size of the first depth image, and an image
        rather than the compressed form of it; "" for clouds, or where there is none.

        Raises:
            FileError: If the given one is absent, or holds other messages or none.
        """
        return self._colours_of(topic)

    def _find_colours(self, topic: str) -> str:
        images = [t for t in self.topics if t.count and t.type in _IMAGE_TYPES and t.name != topic]
        if self.kind_of(topic) not in _IMAGE_TYPES:
            return ""
        if given := str(self._camera.color):
            if given not in (names := [image.name for image in images]):
                raise FileError(self.path, f"--color {none_of(given, names)}", field=topic)
            return given
        fitting = _images_first(image for image in images if self._has_colours(topic, image))
        return fitting[0].name if len(fitting) == 1 else ""

    def _has_colours(self, topic: str, images: Topic) -> bool:
        """Return whether the first image of a topic has colours, in the frame and size of the first depth image of another."""
        try:
            image = self._first(images.name)
            if images.type == _IMAGE_TYPE and image.encoding not in COLOUR_ENCODINGS:
                return False
            depth = self._first(topic)
            colours_of(image, depth.header.frame_id, decode_depth(depth).shape)
        except (CloudError, FileError, StopIteration):
            return False
        return True

    def kind_of(self, topic: str) -> str:
        """Return the type of the messages of a topic; "" where there are none."""
        return next((recorded.type for recorded in self.topics if recorded.name == topic and recorded.count), "")

    def _infos(self) -> list[str]:
        return [recorded.name for recorded in self.topics if recorded.count and recorded.type == _CAMERA_INFO_TYPE]

    def _find_info(self, topic: str) -> str:
        infos = self._infos()
        if self.kind_of(topic) not in _IMAGE_TYPES:
            return ""
        given = self._camera.info_topic
        if given and given not in infos:
            raise FileError(self.path, f"--info-topic {none_of(given, infos)}", field=topic)
        named = [given] if given else [info_topic(topic), _VIEWER.sub(r"\1/\2/info/camera_info", topic)]
        found = next((name for name in named if name in infos), None)
        if found is not None:
            return found
        fitting = [name for name in infos if self._fits(topic, name)]
        return fitting[0] if len(fitting) == 1 else ""

    def _fits(self, topic: str, info: str) -> bool:
        """Return whether the first camera info of a topic is of the frame and size of the first depth image of another."""
        try:
            infos, content = CameraInfos(topic), self._first(topic)
            infos.add(self._first(info), 0.0)
            depth = decode_depth(content)
            infos.camera(content.header.frame_id, (depth.shape[0], depth.shape[1]), 0.0)
        except (CloudError, FileError, StopIteration):
            return False
        return True

    def _unit(self, topic: str) -> float | None:
        """Return the metres per unit that librealsense records beside its depth images; None in other recordings."""
        viewer = _VIEWER.fullmatch(topic)
        unit = f"{viewer[1]}/option/Depth Units/value" if viewer else ""
        if not self.kind_of(unit):
            return None
        return float(self._first(unit).data)

    def is_converted(self, topic: str) -> bool:
        """Return whether nodes would read the depth images of a topic otherwise: with `camera_info` beside them, in the unit of their encoding."""
        if self.kind_of(topic) == POINT_CLOUD_TYPE:
            return False
        stated = {*self._camera.stated} - {"--color"}  # whose topic is played as it is
        return bool(stated) or self.info_topic(topic) != info_topic(topic) or self._unit(topic) is not None

    def first_info(self, topic: str) -> CameraInfos:
        """Read the first camera info of a topic of depth images, which is for the images before it; clouds have no camera info."""
        beside = "" if self._camera.is_known else self.info_topic(topic)
        scale = self._camera.scale if self._camera.scale is not None else self._unit(topic)
        infos = CameraInfos(topic, beside, rectified=self._camera.rectified, scale=scale)
        for message in islice(self.messages([beside]), 1) if beside else ():
            infos.add(self.content(message), message.bag_time_ns * 1e-9)
        return infos

    def clouds(self, topic: str, others: Collection[str] = ()) -> Iterator[tuple[Message, Callable[[], Any]]]:
        """Read the messages of a topic of clouds or depth images, and of other topics, each with what decodes it.

        A depth image has the camera of the last info before it, the first ones the camera of the first info; and its colours,
        where there are any. What decodes a message gives a `Cloud`, or the content of another message, and raises a `FileError` if it is
        damaged or has no camera; the iteration as `messages`.
        """
        infos = self.first_info(topic)
        beside = "" if self._camera.is_known else self.info_topic(topic)
        for message, colours in self.with_colours({topic, beside, *others}, topic, self.color_topic(topic)):
            if message.topic == topic:
                yield message, partial(self.decode_cloud, message, infos, colours)
            elif message.topic == beside:
                infos = deepcopy(infos)  # images before it are perhaps decoded later
                infos.add(self.content(message), message.bag_time_ns * 1e-9)
            else:
                yield message, partial(self.content, message)

    def with_colours(
        self, topics: Collection[str], topic: str, colour_topic: str
    ) -> Iterator[tuple[Message, Message | None]]:
        """Iterate over the messages of some topics in order, each depth image with its colours, which are matched as a node does.

        Args:
            topics: That are read.
            topic: Of the depth images.
            colour_topic: Of the colours, which are not given by themselves; "" for none.
        """
        held: deque[Message] = deque()

        def released(now_ns: float) -> Iterator[tuple[Message, Message | None]]:
            while held:
                message = held[0]
                found = None
                if colour_topic and message.topic == topic and (stamp := _stamp(message)) is not None:
                    if not self.colours.is_final(stamp) and now_ns < message.bag_time_ns + _WAIT_NS:
                        return
                    found = self.colours.match(stamp)
                yield held.popleft(), found

        for message in self.messages({*topics, colour_topic}):
            if message.topic != colour_topic:
                held.append(message)
            elif (stamp := _stamp(message)) is not None:
                self.colours.add(stamp, message)
            yield from released(message.bag_time_ns)
        yield from released(float("inf"))

    def remarks(self, topic: str) -> list[str]:
        """Return what is odd about the camera of the depth images of a topic that were read, and whether some are without colours."""
        remark = self.colours.remark
        return [*self._camera.remarks, *([f"{self.path}: {self.color_topic(topic)}: {remark}"] if remark else [])]

    def messages(self, topics: Collection[str] | None = None) -> Iterator[Message]:
        """Iterate over the messages of some topics, or of all, in order of their bag time.

        Raises a `FileError` where the recording is damaged (of an MCAP file after all messages that are intact), and at its
        end if it holds other counts than it declares.
        """
        counts: Counter[str] = Counter()
        runs = []
        for reader in self._readers:
            wanted = [channel for channel in reader.connections if topics is None or channel.topic in topics]
            if wanted or isinstance(reader, McapStorage):  # whose damage is found in any case
                runs.append(reader.messages(wanted))
        with known_failures(self.path):
            for connection, time_ns, raw in merge(*runs, key=itemgetter(1)):
                topic, definition = connection.topic, _definition(connection)
                _, kind, ros1 = definition
                data = bytes(_typestore(*definition).ros1_to_cdr(raw, kind)) if ros1 else plain(raw, self.path)
                yield Message(topic, kind, counts[topic], time_ns, data, definition)
                counts[topic] += 1
        faults = [file.fault for file in self._readers if isinstance(file, McapStorage) and file.fault]
        if faults:
            rule = faults[0].rule
            if len(faults) > 1:
                rule += f"; also damaged: {', '.join(fault.path.name for fault in faults[1:])}"
            raise FileError(faults[0].path, rule, field=faults[0].field)
        for topic in self.topics:
            if (topics is None or topic.name in topics) and counts[topic.name] != topic.count:
                rule = f"declares {topic.count} messages, holds {counts[topic.name]}"
                raise FileError(self.path, rule, field=topic.name)

    def content(self, message: Message) -> Any:
        """Return the fields of a message, as an object that resembles a ROS message; a `FileError` if it is damaged."""
        with known_failures(self.path, _position(message)):
            try:
                return _typestore(*message.definition).deserialize_cdr(message.data, message.type)
            except KeyError as err:
                rule = f"cannot be decoded: the recording does not define {err.args[0]}, which is no standard type"
                raise FileError(self.path, rule, field=_position(message)) from err

    def _first(self, topic: str) -> Any:
        """Return the fields of the first message of a topic, as `content`; a `StopIteration` if there is none."""
        return self.content(next(self.messages([topic])))

    def decode_cloud(self, message: Message, infos: CameraInfos | None = None, colours: Message | None = None) -> Cloud:
        """Decode a cloud or a depth image, with the frame and stamp of its header; a `FileError` if that fails.

        Args:
            message: The cloud or depth image.
            infos: Cameras of depth images.
            colours: The image with the colours of a depth image. One that does not fit is left out, and counted in `colours`.
        """
        content = self.content(message)
        try:
            if infos is None or message.type == POINT_CLOUD_TYPE:
                return decode_cloud(content)
            rgb = None if colours is None else self._decode_colours(colours, content)
            if not self._camera.is_known:
                return infos.cloud(content, message.bag_time_ns * 1e-9, rgb)
            depth = decode_depth(content)
            model, scale = self._camera.recorded((depth.shape[0], depth.shape[1]), message.topic)
            scale = self._unit(message.topic) if scale is None else scale
            stamped = {"frame_id": content.header.frame_id, "stamp_ns": stamp_ns(content.header.stamp)}
            return Cloud.from_depth(depth, model, scale, rgb=rgb, **stamped)
        except CloudError as err:
            raise FileError(self.path, str(err), field=_position(message)) from err

    def _decode_colours(self, message: Message, depth: Any) -> UInt8 | None:
        """Return the colours (H, W, 3) of a depth image; None, which is counted, if their message is damaged or does not fit."""
        try:
            content = self.content(message)
        except FileError as err:
            self.colours.refuse(str(err))
            return None
        return self.colours.decode(content, depth.header.frame_id, decode_depth(depth).shape)

    def _topics(self) -> Iterator[Topic]:
        for name in sorted({connection.topic for connection in self._connections}):
            connections = [connection for connection in self._connections if connection.topic == name]
            types = {_type_of(connection) for connection in connections}
            kind = types.pop() if len(types) == 1 else ""
            fields = _typestore(*_definition(connections[0])).fielddefs.get(kind, ([], []))[1]
            stamped = bool(fields) and fields[0][1][1] == _HEADER_TYPE
            count, latched = sum(connection.msgcount for connection in connections), any(map(_is_latched, connections))
            yield Topic(name, kind, count, tuple(f[0] for f in fields), stamped, latched)


@cache
def _standard() -> Typesdict:
    from rosbags.typesys import Stores, get_typestore

    return dict(get_typestore(Stores.ROS2_KILTED).fielddefs)


@lru_cache(maxsize=1024)
def _typestore(definition: MessageDefinition, name: str, ros1: bool) -> Typestore:
    """Return a recorded type and all types in it; those without a definition, as before ROS 2 Iron, as in a current release."""
    from rosbags.interfaces import MessageDefinitionFormat
    from rosbags.typesys import Stores, TypesysError, get_types_from_idl, get_types_from_msg, get_typestore

    types: Typesdict = {}
    with suppress(TypesysError):  # costs this type alone
        if definition.format == MessageDefinitionFormat.IDL:
            for part in re.split(r"^=+\nIDL: .*\n", definition.data, flags=re.MULTILINE):
                types.update(get_types_from_idl(part) if part.strip() else {})
        elif definition.format == MessageDefinitionFormat.MSG and (definition.data.strip() or name not in _standard()):
            types.update(get_types_from_msg(definition.data, name))
    if ros1:
        types[_HEADER_TYPE] = _standard()[_HEADER_TYPE]  # of ROS 2, without `seq`
    needed = [name]
    for kind in needed:  # which grows meanwhile
        if kind in types or kind in _standard():
            needed += set(types_in(types.setdefault(kind, _standard().get(kind, ([], [])))[1])) - {*needed}
    store = get_typestore(Stores.EMPTY)
    store.register({kind: types[kind] for kind in needed if kind in types})
    return store


def _definition(connection: Connection) -> tuple[MessageDefinition, str, bool]:
    """Return what the messages of a connection are decoded by; two of a recording may define a type otherwise."""
    serialization = getattr(connection.ext, "serialization_format", "ros1")  # bags of ROS 1 have no other
    return connection.msgdef, _type_of(connection), serialization == "ros1"


def types_in(fields: Any) -> Iterator[str]:
    """Iterate over the names of message types in the fields of another, the only texts there with a slash."""
    for part in fields:
        if isinstance(part, tuple | list):
            yield from types_in(part)
        elif isinstance(part, str) and "/" in part:
            yield part


def _contradictions(path: Path, files: Collection[Path], topics: Collection[Topic]) -> Iterator[str]:
    """Yield what the `metadata.yaml` of a directory states otherwise than the files have it."""
    file = path / _METADATA
    if not file.is_file():
        return
    try:
        stated = load_yaml(file, 10_000_000)["rosbag2_bagfile_information"]
        names = {Path(name).name for name in stated["relative_file_paths"]}
        stated_counts = {
            entry["topic_metadata"]["name"]: entry["message_count"] for entry in stated["topics_with_message_count"]
        }
    except (ForetouchError, KeyError, TypeError, AttributeError) as err:
        yield f"{file}: cannot be read, the files decide: {' '.join(str(err).split())}"
        return
    present = {file.name for file in files}
    for name in sorted(names ^ present):
        yield f"{file}: {f'lists {name}, which is absent' if name in names else f'does not list {name}, which was read'}"
    counts = {topic.name: topic.count for topic in topics}
    for name in sorted(stated_counts.keys() | counts.keys()):
        if stated_counts.get(name, 0) != counts.get(name, 0):
            yield f"{file}: {name}: states {stated_counts.get(name, 0)} messages, the files hold {counts.get(name, 0)}"


def is_recording(path: Path) -> bool:
    """Return whether the path looks like a recording, by its name or, for a directory, by the files in it."""
    if path.is_dir():
        return (path / _METADATA).is_file() or bool(_loose_files(path))
    return path.suffix in RECORDING_SUFFIXES or path.name.endswith(_PACKED_SUFFIXES)


def _storage_files(path: Path) -> list[Path]:
    """Return the files of a recording, all of them regular ones."""
    require_existing(path)
    if not is_recording(path):
        raise FileError(
            path, f"is not a recording: neither a rosbag2 directory nor a file of {', '.join(RECORDING_SUFFIXES)}"
        )
    files = _loose_files(path) if path.is_dir() else [path]
    for file in files:
        open_regular(file).close()  # opening a FIFO would wait without end
    if not files:
        raise FileError(path, f"holds none of the files (.mcap, .db3) that its {_METADATA} is about")
    return files


def _loose_files(path: Path) -> list[Path]:
    return sorted(p for p in path.iterdir() if p.suffix in {".mcap", ".db3"} or p.name.endswith(_PACKED_SUFFIXES))


def _type_of(connection: Connection) -> str:
    """Return the ROS 2 name of a type, such as `std_msgs/msg/String`; with its encoding where that is not one of ROS."""
    kind, encoding = connection.msgtype, getattr(connection.ext, "serialization_format", "ros1")
    kind = kind if kind.count("/") != 1 else kind.replace("/", "/msg/")
    return kind if encoding in {"cdr", "ros1"} else f"{kind} as {encoding}"


def _is_latched(connection: Connection) -> bool:
    from rosbags.interfaces import QosDurability

    profiles = getattr(connection.ext, "offered_qos_profiles", [])  # of ROS 2
    latching = bool(getattr(connection.ext, "latching", False))  # of ROS 1
    return latching or any(profile.durability == QosDurability.TRANSIENT_LOCAL for profile in profiles)


def _stamp(message: Message) -> int | None:
    """Return the stamp of a message [ns]; None for one that is cut off, which is refused where it is decoded."""
    try:
        return read_header(message.data)[0]
    except DatasetError:
        return None


def _position(message: Message) -> str:
    return f"{message.topic}[{message.index}]"


def _images_first(topics: Iterable[Topic]) -> list[Topic]:
    """Return topics of images without those that hold the compressed form of another one."""
    topics = list(topics)
    raw = {topic.name for topic in topics if topic.type == _IMAGE_TYPE}
    return [topic for topic in topics if topic.name in raw or topic.name.rpartition("/")[0] not in raw]


def _listed(topics: Collection[Topic]) -> str:
    return ", ".join(f"{t.name} ({t.type or 'mixed types'}, {t.count})" for t in topics) or "none"
