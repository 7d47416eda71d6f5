# SPDX-License-Identifier: Apache-2.0
"""Writes rosbag2 directories with MCAP storage, without ROS; `foretouch.dataset.recordings.bag` reads them.

The samples of a dataset are exported with their clouds as messages of a second topic.
"""

import shutil
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Final, Self

from rosbags.interfaces import Connection
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.rosbag2.enums import CompressionFormat, CompressionMode
from rosbags.rosbag2.errors import WriterError

from foretouch.base.files import system_errors
from foretouch.dataset.recordings.bag import POINT_CLOUD_TYPE
from foretouch.dataset.recordings.sample_codec import (
    SAMPLE_TOPIC,
    SAMPLE_TYPE,
    Definitions,
    encode_sample,
    serialize_cloud,
)
from foretouch.dataset.samples import ExportResult, SampleSet
from foretouch.errors import DatasetError, FileError
from foretouch.types import Cloud

_CLOUD_TOPIC: Final = "/foretouch/points"


class BagWriter:
    """Writes a recording, a new directory; a context manager. If the block ends with an exception, it is removed.

    A `FileError` if the path exists, or cannot be created.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self.definitions = Definitions()  # register the message types that are not installed
        self._connections: dict[str, Connection] = {}
        try:
            self._writer = Writer(self.path, version=Writer.VERSION_LATEST, storage_plugin=StoragePlugin.MCAP)
            self._writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
            with system_errors(self.path):
                self._writer.open()
        except WriterError as err:
            raise FileError(self.path, "exists already and is not overwritten") from err

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is None:
            self._writer.close()
        else:
            self._writer.abort()
            shutil.rmtree(self.path, ignore_errors=True)

    def add_topic(self, topic: str, type_name: str) -> Connection:
        """Declare a topic; a `DatasetError` if its type has no definition, or the topic has another type."""
        if topic not in self._connections:
            self.definitions.text(type_name)
            self._connections[topic] = self._writer.add_connection(topic, type_name, typestore=self.definitions.store)
        if self._connections[topic].msgtype != type_name:
            raise DatasetError(f"{self.path}: {topic}: holds {self._connections[topic].msgtype}, not {type_name}")
        return self._connections[topic]

    def write(self, topic: str, type_name: str, bag_time_ns: int, data: bytes | memoryview) -> None:
        """Append a message.

        Args:
            topic: Its topic, which is declared if it is new.
            type_name: Of the message, such as `sensor_msgs/msg/PointCloud2`.
            bag_time_ns: When it was received [ns].
            data: The message in CDR, with its encapsulation header.

        Raises:
            DatasetError: If its type is unknown or another than of its topic, or the time is before 1970.
        """
        if bag_time_ns < 0:
            raise DatasetError(f"{self.path}: {topic}: time {bag_time_ns} ns is before 1970")
        self._writer.write(self.add_topic(topic, type_name), bag_time_ns, data)

    def write_cloud(self, cloud: Cloud, topic: str = _CLOUD_TOPIC, *, bag_time_ns: int | None = None) -> None:
        """Append a cloud as `sensor_msgs/PointCloud2`, by default at the time of its stamp [ns]."""
        time_ns = cloud.stamp_ns if bag_time_ns is None else bag_time_ns
        self.write(topic, POINT_CLOUD_TYPE, time_ns, serialize_cloud(cloud))


def write_bag(path: str | Path, clouds: Iterable[Cloud]) -> int:
    """Write clouds as a recording of the topic `/foretouch/points`, and return their number.

    Args:
        path: A new folder.
        clouds: With frame and stamp.

    Raises:
        FileError: If the folder exists, or cannot be written.
    """
    count = 0
    with BagWriter(path) as writer:
        writer.add_topic(_CLOUD_TOPIC, POINT_CLOUD_TYPE)
        for cloud in clouds:
            writer.write_cloud(cloud)
            count += 1
    return count


def export(samples: SampleSet, out: Path, result: ExportResult, progress: Callable[[], None]) -> None:
    """Write samples in this format (arguments: `export` in `foretouch.dataset.formats`)."""
    with BagWriter(out) as writer:
        writer.add_topic(SAMPLE_TOPIC, SAMPLE_TYPE)
        for sample in samples.with_discarded():
            progress()
            stamp_ns = sample.stamp_ns
            data = encode_sample(sample, samples.identity, samples.sensor)
            writer.write(SAMPLE_TOPIC, SAMPLE_TYPE, stamp_ns, data)
            writer.write_cloud(sample.cloud, "/foretouch/object_cloud", bag_time_ns=stamp_ns)
            result.samples += 1
