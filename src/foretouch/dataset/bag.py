# SPDX-License-Identifier: Apache-2.0
"""Reads ROS recordings without ROS: rosbag2 directories (MCAP, SQLite), bare files, ROS 1 bags.

`rosbags` reads the containers and message definitions. `Recording` returns the messages as they were recorded, for
replay, and the clouds in them. For writing see `foretouch.dataset.bag_writer`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from foretouch.cloud.messages import decode_cloud
from foretouch.errors import CloudError, FileError
from foretouch.files import open_regular, require_existing
from foretouch.types import Cloud

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader
    from rosbags.interfaces import Connection
    from rosbags.typesys.store import Typestore


POINT_CLOUD_TYPE = "sensor_msgs/msg/PointCloud2"
HEADER_TYPE = "std_msgs/msg/Header"
RECORDING_SUFFIXES = (".mcap", ".db3", ".bag")
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


class Recording:
    """An open recording; a context manager.

    Args:
        path: A rosbag2 directory, a directory of `.mcap` or `.db3` files, such a file, or a ROS 1 `.bag`.

    Raises:
        FileError: If the path is not a recording, or is truncated or damaged.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        files = _storage_paths(self.path)
        with _known_failures(self.path):
            from rosbags.highlevel import AnyReader
            from rosbags.typesys import Stores, get_typestore

            # Recordings of ROS 2 before Iron hold no definitions: fall back to those of a current release.
            self._reader: AnyReader = AnyReader(files, default_typestore=get_typestore(Stores.ROS2_KILTED))
            self._reader.open()
        try:
            with _known_failures(self.path):
                self._store = self._reader.typestore if self._reader.is2 else _without_seq(self._reader.typestore)
                self.topics: tuple[Topic, ...] = tuple(self._topics())
        except FileError:
            self.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the files; may be called more than once."""
        if self._reader.stack is not None:
            self._reader.close()

    def cloud_topic(self, topic: str | None = None) -> str:
        """The topic of the clouds, which is checked, or found if `topic` is None.

        Raises a `FileError` if the topic is absent, holds other messages or none, or if several qualify.
        """
        named = [t for t in self.topics if (t.name == topic if topic else not t.name.startswith(_TAXELS))]
        clouds = [t for t in named if t.type == POINT_CLOUD_TYPE and t.count]
        if len(clouds) != 1:
            rule = "several topics of clouds, name one with --topic" if clouds else f"no messages of {POINT_CLOUD_TYPE}"
            raise FileError(self.path, f"{rule}: {_listed(clouds or self.topics)}", field=topic)
        return clouds[0].name

    def messages(self, topics: Collection[str] | None = None) -> Iterator[Message]:
        """The messages of some topics, or of all, in order of their bag time.

        Raises a `FileError` where the recording is damaged, and at its end if it holds other counts than it declares.
        """
        wanted = [c for c in self._reader.connections if topics is None or c.topic in topics]
        counts: Counter[str] = Counter()
        if wanted:
            with _known_failures(self.path):
                for connection, time_ns, raw in self._reader.messages(wanted):
                    data = raw if self._reader.is2 else bytes(self._store.ros1_to_cdr(raw, connection.msgtype))
                    yield Message(connection.topic, connection.msgtype, counts[connection.topic], time_ns, data)
                    counts[connection.topic] += 1
        for topic in self.topics:
            if (topics is None or topic.name in topics) and counts[topic.name] != topic.count:
                rule = f"declares {topic.count} messages, holds {counts[topic.name]}"
                raise FileError(self.path, rule, field=topic.name)

    def content(self, message: Message) -> Any:
        """The fields of a message, as an object that resembles a ROS message; a `FileError` if it is damaged."""
        with _known_failures(self.path, _position(message)):
            return self._store.deserialize_cdr(message.data, message.type)

    def decode_cloud(self, message: Message) -> Cloud:
        """The cloud in a `PointCloud2`, with the frame and stamp of its header; a `FileError` if it is damaged."""
        try:
            return decode_cloud(self.content(message))
        except CloudError as err:
            raise FileError(self.path, str(err), field=_position(message)) from err

    def _topics(self) -> Iterator[Topic]:
        definitions = self._store.fielddefs
        for name, info in sorted(self._reader.topics.items()):
            fields = definitions[info.msgtype][1] if info.msgtype in definitions else []
            stamped = bool(fields) and fields[0][1][1] == HEADER_TYPE
            latched = any(_is_latched(connection) for connection in info.connections)
            yield Topic(name, info.msgtype or "", info.msgcount, tuple(f[0] for f in fields), stamped, latched)


def is_recording(path: Path) -> bool:
    """Whether the path looks like a recording, by its name or, for a directory, by the files in it."""
    if path.is_dir():
        return (path / "metadata.yaml").is_file() or bool(_loose_files(path))
    return path.suffix in RECORDING_SUFFIXES


def _storage_paths(path: Path) -> list[Path]:
    """The directory or file itself, or the files of a directory without metadata; all of them are regular files."""
    require_existing(path)
    if not is_recording(path):
        raise FileError(
            path, f"is not a recording: neither a rosbag2 directory nor a file of {', '.join(RECORDING_SUFFIXES)}"
        )
    for file in (one for one in (path.iterdir() if path.is_dir() else [path]) if not one.is_dir()):
        open_regular(file).close()  # opening a FIFO would wait without end
    return _loose_files(path) if path.is_dir() and not (path / "metadata.yaml").is_file() else [path]


def _loose_files(path: Path) -> list[Path]:
    return sorted(p for suffix in (".mcap", ".db3") for p in path.glob(f"*{suffix}"))


@contextmanager
def _known_failures(path: Path, position: str | None = None) -> Iterator[None]:
    """Turn the parsers' exceptions into one line; damaged bytes make them raise those of any library and of Python."""
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


def _without_seq(recorded: Typestore) -> Typestore:
    """The definitions of a ROS 1 bag with the `std_msgs/Header` of ROS 2, which has no `seq`."""
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.EMPTY)
    store.register({**recorded.fielddefs, HEADER_TYPE: get_typestore(Stores.ROS2_KILTED).fielddefs[HEADER_TYPE]})
    return store


def _is_latched(connection: Connection) -> bool:
    from rosbags.interfaces import QosDurability

    profiles = getattr(connection.ext, "offered_qos_profiles", [])  # of ROS 2
    latching = bool(getattr(connection.ext, "latching", False))  # of ROS 1
    return latching or any(profile.durability == QosDurability.TRANSIENT_LOCAL for profile in profiles)


def _position(message: Message) -> str:
    return f"{message.topic}[{message.index}]"


def _listed(topics: Collection[Topic]) -> str:
    return ", ".join(f"{t.name} ({t.type or 'mixed types'}, {t.count})" for t in topics) or "none"
