# SPDX-License-Identifier: Apache-2.0
"""Writes rosbag2 directories with MCAP storage, without ROS; `foretouch.dataset.bag` reads them.

The samples of a dataset are exported with their clouds as messages of a second topic.
"""

import shutil
import zlib
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Final, Literal, Self

from rosbags.interfaces import Connection
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.rosbag2.enums import CompressionFormat, CompressionMode
from rosbags.rosbag2.errors import WriterError
from rosbags.rosbag2.storage_mcap import McapWriter

from foretouch.dataset.bag import POINT_CLOUD_TYPE
from foretouch.dataset.messages import cloud_fields
from foretouch.dataset.recording.definitions import Definitions
from foretouch.dataset.recording.sample_codec import SAMPLE_TOPIC, SAMPLE_TYPE, encode_sample, sample_types
from foretouch.dataset.samples import DatasetFormat, ExportResult, SampleSet
from foretouch.errors import DatasetError, FileError
from foretouch.types import Cloud

DEFAULT_TOPIC: Final = "/foretouch/points"
Compression = Literal["none", "zstd"]

_OBJECT_CLOUD_TOPIC: Final = "/foretouch/object_cloud"
_CHUNK_CRC_OFFSET = 9 + 24  # opcode and length of the record, then start time, end time and size


class BagWriter:
    """Writes a recording; a context manager. If the block ends with an exception, the recording is removed.

    Args:
        path: Directory to create.
        compression: Compression of the MCAP chunks.

    Raises:
        FileError: If the path exists, or cannot be created.
    """

    def __init__(self, path: str | Path, compression: Compression = "zstd") -> None:
        self.path = Path(path)
        self._definitions = Definitions()
        self._connections: dict[str, Connection] = {}
        try:
            self._writer = _Writer(self.path, version=Writer.VERSION_LATEST, storage_plugin=StoragePlugin.MCAP)
            if compression == "zstd":
                self._writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
            self._writer.open()
        except WriterError as err:
            raise FileError(self.path, "exists already and is not overwritten") from err
        except OSError as err:
            raise FileError(self.path, err.strerror or str(err)) from err

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is None:
            self._writer.close()
        else:
            self._writer.abort()
            shutil.rmtree(self.path, ignore_errors=True)

    def write_cloud(self, cloud: Cloud, topic: str = DEFAULT_TOPIC, *, bag_time_ns: int | None = None) -> None:
        """Append a cloud as `sensor_msgs/PointCloud2`, with its frame and stamp.

        Args:
            cloud: Organised or not.
            topic: Its topic.
            bag_time_ns: When it was received [ns]; by default its own stamp.

        Raises:
            DatasetError: If a time is negative or beyond 2038, where the stamps of ROS end.
        """
        time_ns = cloud.stamp_ns if bag_time_ns is None else bag_time_ns
        self.write(topic, POINT_CLOUD_TYPE, time_ns, serialize_cloud(cloud))

    def write(self, topic: str, type_name: str, bag_time_ns: int, data: bytes | memoryview) -> None:
        """Append a serialised message.

        Args:
            topic: Its topic.
            type_name: Such as `std_msgs/msg/String`: of ROS 2 Kilted, or registered by `define`.
            bag_time_ns: When it was received [ns], at least 0.
            data: CDR with its encapsulation header.

        Raises:
            DatasetError: If the type is unknown, or the topic already has another one, or the time is negative.
        """
        if bag_time_ns < 0:
            raise DatasetError(f"{self.path}: {topic}: time {bag_time_ns} ns is before 1970")
        self._writer.write(self._connection(topic, type_name), bag_time_ns, data)

    def add_topic(self, topic: str, type_name: str) -> None:
        """Declare a topic, even if no message follows (raises as `write`)."""
        self._connection(topic, type_name)

    def define(self, type_name: str, definition: str) -> None:
        """Register a message type, such as `foretouch_msgs/msg/Biotac`, by the text of its `.msg` file."""
        self._definitions.register(type_name, definition)

    def _connection(self, topic: str, type_name: str) -> Connection:
        connection = self._connections.get(topic)
        if connection is None:
            if type_name not in self._definitions.store.fielddefs:
                raise DatasetError(f"{self.path}: {topic}: no definition of {type_name}")
            connection = self._writer.add_connection(topic, type_name, typestore=self._definitions.store)
            self._connections[topic] = connection
        if connection.msgtype != type_name:
            raise DatasetError(f"{self.path}: {topic}: holds {connection.msgtype}, not {type_name}")
        return connection


def write_bag(
    path: str | Path, clouds: Iterable[Cloud], topic: str = DEFAULT_TOPIC, *, compression: Compression = "zstd"
) -> int:
    """Write clouds as a recording of one topic; their stamps become the bag times (raises as `BagWriter`).

    Returns:
        Number of clouds written.
    """
    count = 0
    with BagWriter(path, compression) as writer:
        writer.add_topic(topic, POINT_CLOUD_TYPE)
        for cloud in clouds:
            writer.write_cloud(cloud, topic)
            count += 1
    return count


class _ChecksummedMcap(McapWriter):
    """Writes the checksum of each chunk, which `rosbags` leaves at 0 = unknown, so that readers detect damage."""

    def close_chunk(self) -> None:
        checksum = zlib.crc32(self.chunk.bio.getbuffer())
        start = self.bio.tell()
        super().close_chunk()
        end = self.bio.tell()
        self.bio.seek(start + _CHUNK_CRC_OFFSET)
        self.bio.write(checksum.to_bytes(4, "little"))
        self.bio.seek(end)


class _Writer(Writer):
    STORAGE_PLUGINS = {**Writer.STORAGE_PLUGINS, StoragePlugin.MCAP: _ChecksummedMcap}  # noqa: RUF012  # read only


def serialize_cloud(cloud: Cloud) -> bytes:
    """A cloud as the CDR of a `sensor_msgs/PointCloud2`, encapsulation header included.

    Raises:
        DatasetError: If ROS cannot represent the stamp.
    """
    return bytes(sample_types().store.serialize_cdr(cloud_fields(cloud), POINT_CLOUD_TYPE))


def _export(samples: SampleSet, out: Path, result: ExportResult, progress: Callable[[], None]) -> None:
    with BagWriter(out) as writer:
        writer.define(SAMPLE_TYPE, sample_types().text(SAMPLE_TYPE))
        writer.add_topic(SAMPLE_TOPIC, SAMPLE_TYPE)
        for k in range(len(samples)):
            progress()
            record = samples.record(k)
            data = encode_sample(record, samples.identity)
            writer.write(SAMPLE_TOPIC, SAMPLE_TYPE, record.sample.stamp_ns, data)
            writer.write_cloud(record.sample.cloud, _OBJECT_CLOUD_TOPIC, bag_time_ns=record.sample.stamp_ns)
            result.written += 1


DATASET_FORMAT = DatasetFormat(export=_export)
