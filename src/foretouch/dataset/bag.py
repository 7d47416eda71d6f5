# SPDX-License-Identifier: Apache-2.0
"""Reads ROS recordings without ROS: rosbag2 directories (MCAP, SQLite), bare files, ROS 1 bags.

`rosbags` reads SQLite, ROS 1 bags and message definitions, `McapReader` MCAP files, also where an index or their end is
missing. What a `metadata.yaml` states is compared with the files, which decide. `Recording` returns the messages as they
were recorded, for replay, and the clouds in them. For writing see `foretouch.dataset.bag_writer`.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Collection, Iterator
from contextlib import ExitStack, contextmanager, suppress
from copy import deepcopy
from dataclasses import dataclass
from functools import cache, lru_cache, partial
from heapq import merge
from itertools import islice
from operator import itemgetter
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Final, Self

from foretouch.cloud.io.depth_messages import ENCODINGS, CameraInfos, info_topic
from foretouch.cloud.messages import decode_cloud
from foretouch.config import load_yaml
from foretouch.dataset.mcap_reader import Damage, McapReader
from foretouch.errors import CloudError, FileError, ForetouchError
from foretouch.files import open_regular, require_existing
from foretouch.types import Cloud

if TYPE_CHECKING:
    from rosbags.interfaces import Connection, MessageDefinition
    from rosbags.interfaces.typing import Typesdict
    from rosbags.typesys.store import Typestore


POINT_CLOUD_TYPE = "sensor_msgs/msg/PointCloud2"
_IMAGE_TYPE = "sensor_msgs/msg/Image"
_COMPRESSED_TYPE = "sensor_msgs/msg/CompressedImage"
_CAMERA_INFO_TYPE = "sensor_msgs/msg/CameraInfo"
_HEADER_TYPE = "std_msgs/msg/Header"
RECORDING_SUFFIXES = (".mcap", ".db3", ".bag")
_PACKED: Final = ".zstd"  # at the end of the names of files that were compressed as a whole
_PACKED_SUFFIXES: Final = (".mcap.zstd", ".db3.zstd")
_METADATA: Final = "metadata.yaml"
_ZSTD: Final = bytes.fromhex("28b52ffd")  # with which no CDR begins
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

    Attributes:
        topics: What it holds; of an MCAP file without an index, as far as it is intact.
        notes: Where its `metadata.yaml` states something else than is in the files, one line each.

    Raises:
        FileError: If the path is not a recording, or is truncated or damaged. An MCAP file is read as far as it is intact.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        files = _storage_files(self.path)
        with ExitStack() as stack:
            self._readers = [_opened(file, stack) for file in files]
            with _known_failures(self.path):
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
            qualified = [t for t in named if self._is_depth(t)]
            raw = {t.name for t in qualified if t.type == _IMAGE_TYPE}
            qualified = [t for t in qualified if t.type == _IMAGE_TYPE or t.name.rpartition("/")[0] not in raw]
        if len(qualified) != 1:
            rule = "several topics of clouds or depth images, name one with --topic"
            if not qualified:
                rule = f"no messages of {POINT_CLOUD_TYPE}, nor depth images ({', '.join(ENCODINGS)}, compressedDepth)"
            raise FileError(self.path, f"{rule}: {_listed(qualified or self.topics)}", field=topic)
        name = qualified[0].name
        if qualified[0].type != POINT_CLOUD_TYPE and not self.info_topic(name):
            rule = f"depth images need their camera info, and {info_topic(name)} is absent: record it too"
            raise FileError(self.path, rule, field=name)
        return name

    def _is_depth(self, topic: Topic) -> bool:
        if topic.type == _COMPRESSED_TYPE:
            return topic.name.endswith("/compressedDepth")
        if topic.type != _IMAGE_TYPE:
            return False
        try:
            return self.content(next(self.messages([topic.name]))).encoding in ENCODINGS
        except (FileError, StopIteration):
            return False

    def info_topic(self, topic: str) -> str:
        """Find the topic of the camera infos of depth images; "" for clouds, or where it is absent."""
        types = {recorded.name: recorded.type for recorded in self.topics if recorded.count}
        beside = info_topic(topic)
        return (
            beside
            if types.get(topic) in {_IMAGE_TYPE, _COMPRESSED_TYPE} and types.get(beside) == _CAMERA_INFO_TYPE
            else ""
        )

    def first_info(self, topic: str) -> CameraInfos:
        """Read the first camera info of a topic of depth images, which is for the images before it; clouds have no camera info."""
        infos, beside = CameraInfos(topic), self.info_topic(topic)
        for message in islice(self.messages([beside]), 1) if beside else ():
            infos.add(self.content(message), message.bag_time_ns * 1e-9)
        return infos

    def clouds(self, topic: str) -> Iterator[tuple[Message, Callable[[], Cloud]]]:
        """Read the messages of a topic of clouds or depth images, each with what decodes it.

        A depth image has the camera of the last info before it, the first ones the camera of the first info. What decodes a
        message raises a `FileError` if it is damaged or has no camera; the iteration as `messages`.
        """
        beside, infos = self.info_topic(topic), self.first_info(topic)
        for message in self.messages({topic, beside}):
            if message.topic == topic:
                yield message, partial(self.decode_cloud, message, infos)
            else:
                infos = deepcopy(infos)  # images before it are perhaps decoded later
                infos.add(self.content(message), message.bag_time_ns * 1e-9)

    def messages(self, topics: Collection[str] | None = None) -> Iterator[Message]:
        """Iterate over the messages of some topics, or of all, in order of their bag time.

        Raises a `FileError` where the recording is damaged (of an MCAP file after all messages that are intact), and at its
        end if it holds other counts than it declares.
        """
        counts: Counter[str] = Counter()
        runs = []
        for reader in self._readers:
            wanted = [channel for channel in reader.connections if topics is None or channel.topic in topics]
            if wanted or isinstance(reader, _McapFile):  # whose damage is found in any case
                runs.append(reader.messages(wanted))
        with _known_failures(self.path):
            for connection, time_ns, raw in merge(*runs, key=itemgetter(1)):
                topic, definition = connection.topic, _definition(connection)
                _, kind, ros1 = definition
                data = bytes(_typestore(*definition).ros1_to_cdr(raw, kind)) if ros1 else _plain(raw)
                yield Message(topic, kind, counts[topic], time_ns, data, definition)
                counts[topic] += 1
        faults = [file.fault for file in self._readers if isinstance(file, _McapFile) and file.fault]
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
        with _known_failures(self.path, _position(message)):
            try:
                return _typestore(*message.definition).deserialize_cdr(message.data, message.type)
            except KeyError as err:
                rule = f"cannot be decoded: the recording does not define {err.args[0]}, which is no standard type"
                raise FileError(self.path, rule, field=_position(message)) from err

    def decode_cloud(self, message: Message, infos: CameraInfos | None = None) -> Cloud:
        """Decode a cloud or a depth image, with the frame and stamp of its header; a `FileError` if that fails."""
        content = self.content(message)
        try:
            if infos is None or message.type == POINT_CLOUD_TYPE:
                return decode_cloud(content)
            return infos.cloud(content, message.bag_time_ns * 1e-9)
        except CloudError as err:
            raise FileError(self.path, str(err), field=_position(message)) from err

    def _topics(self) -> Iterator[Topic]:
        for name in sorted({connection.topic for connection in self._connections}):
            connections = [connection for connection in self._connections if connection.topic == name]
            types = {_type_of(connection) for connection in connections}
            kind = types.pop() if len(types) == 1 else ""
            fields = _typestore(*_definition(connections[0])).fielddefs.get(kind, ([], []))[1]
            stamped = bool(fields) and fields[0][1][1] == _HEADER_TYPE
            count, latched = sum(connection.msgcount for connection in connections), any(map(_is_latched, connections))
            yield Topic(name, kind, count, tuple(f[0] for f in fields), stamped, latched)


class _McapFile:
    """An MCAP file behind the interface of the readers of `rosbags`."""

    def __init__(self, path: Path, shown: Path) -> None:
        from rosbags.interfaces import Connection, ConnectionExtRosbag2, MessageDefinition, MessageDefinitionFormat
        from rosbags.rosbag2.metadata import parse_qos

        self.fault: FileError | None = None
        self._shown = shown
        self._file = McapReader(path)
        counts = self._file.count_messages()
        self.connections: list[Connection] = []
        formats = {"ros2msg": MessageDefinitionFormat.MSG, "ros1msg": MessageDefinitionFormat.MSG}
        formats |= dict.fromkeys(("ros2idl", "omgidl"), MessageDefinitionFormat.IDL)
        for number, channel in sorted(self._file.channels.items()):
            schema = self._file.schemas.get(channel.schema_id)
            form = formats.get(schema.encoding if schema else "", MessageDefinitionFormat.NONE)
            text = schema.data.decode("utf-8", "replace") if schema else ""
            qos: list[Any] = []
            with suppress(Exception):  # is advice, and others write texts of their own
                qos = parse_qos(channel.metadata.get("offered_qos_profiles", ""))
            ext = ConnectionExtRosbag2(channel.message_encoding or "cdr", qos)
            definition = MessageDefinition(form, text)
            kind = schema.name if schema else ""
            self.connections.append(Connection(number, channel.topic, kind, definition, "", counts[number], ext, self))

    def messages(self, connections: Collection[Connection]) -> Iterator[tuple[Connection, int, bytes]]:
        """Iterate over the messages of some connections with their times [ns], in order; damage then is the `fault`."""
        by_number = {connection.id: connection for connection in connections}
        faults: list[Damage] = []
        for item in self._file.in_time({connection.topic for connection in connections}):
            if isinstance(item, Damage):
                faults.append(item)
            elif item[0].channel in by_number:
                yield by_number[item[0].channel], item[0].log_time_ns, item[1]
        if faults:
            first = faults[0].error(self._shown)
            cure = f"what is intact was read; `foretouch dataset repair {self._shown}` makes a complete file of it"
            cure = cure if any(connection.msgcount for connection in self.connections) else "no message can be read"
            self.fault = FileError(self._shown, f"{first.rule}: {cure}", field=first.field)


def _opened(file: Path, stack: ExitStack) -> Any:
    """Return a reader of one file, with `connections` and `messages`; it is closed with the stack."""
    from rosbags.rosbag1 import Reader as Ros1Reader
    from rosbags.rosbag2 import Reader as Ros2Reader

    opened = file
    if file.suffix == _PACKED:
        opened = _unpacked(file, Path(stack.enter_context(TemporaryDirectory())))
    if opened.suffix == ".mcap":
        return _McapFile(opened, file)
    journal = opened.with_name(f"{opened.name}-wal")
    if journal.is_file() and journal.stat().st_size:
        cure = (
            f"was not closed, and holds messages in {journal.name}: `sqlite3 {file} 'PRAGMA wal_checkpoint(TRUNCATE)'`"
        )
        raise FileError(file, cure)
    with _known_failures(file):
        return stack.enter_context(Ros1Reader(opened) if opened.suffix == ".bag" else Ros2Reader(opened))


def _unpacked(file: Path, folder: Path) -> Path:
    """Return a file that was compressed as a whole, unpacked into a folder."""
    import zstandard

    unpacked = folder / file.stem
    with _known_failures(file), open_regular(file) as packed, unpacked.open("wb") as out:
        zstandard.ZstdDecompressor().copy_stream(packed, out)
    return unpacked


def _plain(data: bytes) -> bytes:
    """Return a message, which may have been compressed by itself."""
    if not data.startswith(_ZSTD):
        return data
    import zstandard

    return bytes(zstandard.ZstdDecompressor().decompressobj().decompress(data))


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


@contextmanager
def _known_failures(path: Path, position: str | None = None) -> Iterator[None]:
    """Turn the parsers' exceptions into one line; damaged bytes make them raise exceptions of any library and of Python."""
    try:
        yield
    except FileError:
        raise
    except PermissionError as err:
        raise FileError(path, err.strerror or "may not be read", field=position) from err
    except Exception as err:
        cause = " ".join(str(err).split())
        if not type(err).__module__.startswith("rosbags"):
            cause = f"{type(err).__name__}: {cause}" if cause else type(err).__name__
        raise FileError(path, f"truncated or damaged: {cause}", field=position) from err


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


def _position(message: Message) -> str:
    return f"{message.topic}[{message.index}]"


def _listed(topics: Collection[Topic]) -> str:
    return ", ".join(f"{t.name} ({t.type or 'mixed types'}, {t.count})" for t in topics) or "none"
