# SPDX-License-Identifier: Apache-2.0
"""An MCAP file that always ends where a chunk ends.

`mcap.writer` makes the bytes. Each chunk is passed to the system in one call, and the remains of a failed write are cut
off again. By default chunks are not compressed: a reader finds a message by its offset, and one damaged byte costs one chunk.
"""

import os
import sys
from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Final

from mcap.records import Attachment, Channel, Header, Message, Schema
from mcap.writer import CompressionType, Writer

from foretouch import __version__
from foretouch.errors import DatasetError, FileError
from foretouch.files import system_errors

LIBRARY: Final = f"foretouch {__version__}"


class McapFile:
    """A new MCAP file, by default of the profile `ros2`; a `FileError` if the path exists or cannot be written. Not thread-safe.

    So do all methods that write; nothing of what they were to write is then in the file.
    """

    def __init__(
        self, path: str | Path, header: Header | None = None, compression: CompressionType = CompressionType.NONE
    ) -> None:
        self.path = Path(path)
        self.types: dict[str, str] = {}  # of the messages, by declared topic
        self.size = 0  # so far [bytes]
        with system_errors(self.path):
            self._fd = os.open(self.path, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_APPEND, 0o644)
        self._parts: list[bytes] = []  # made by the writer, and not in the file yet
        self._schemas: dict[tuple[str, str, bytes], int] = {}
        self._channels: dict[str, int] = {}
        self._failed = False
        end = lambda: self.size + sum(map(len, self._parts))  # noqa: E731
        output: Any = SimpleNamespace(write=self._parts.append, tell=end, flush=lambda: None)
        self._writer: Any = Writer(output, chunk_size=sys.maxsize, compression=compression, enable_data_crcs=True)
        self._writer.start(*(("ros2", LIBRARY) if header is None else (header.profile, header.library)))
        self._commit()

    def declare(self, topic: str, type_name: str, definition: str) -> int:
        """Declare a topic of messages such as `std_msgs/msg/String`, with their definition as `ros2msg`; gives its number."""
        schema = Schema(0, definition.encode(), "ros2msg", type_name)
        self._channels[topic] = self.add_channel(Channel(0, topic, "cdr", {"offered_qos_profiles": ""}, 0), schema)
        self.types[topic] = type_name
        return self._channels[topic]

    def add_channel(self, channel: Channel, schema: Schema | None) -> int:
        """Declare a channel as another file does, with the schema of its messages if it has one; gives its number here."""
        number = 0
        if schema is not None:
            key = schema.name, schema.encoding, schema.data
            number = self._schemas.get(key) or self._schemas.setdefault(key, self._writer.register_schema(*key))
        return int(self._writer.register_channel(channel.topic, channel.message_encoding, number, channel.metadata))

    def message(self, topic: str, data: bytes, log_time_ns: int, sent_ns: int, sequence: int) -> Message:
        """Return a message of a declared topic, to be written; a `DatasetError` if the topic or a time [ns] is invalid.

        Args:
            topic: A declared topic.
            data: The serialised message.
            log_time_ns: When it was received [ns].
            sent_ns: When it was sent [ns].
            sequence: Its number by the publisher.
        """
        if topic not in self._channels:
            raise DatasetError(f"{self.path}: {topic} was not declared by add_topic")
        for name, time_ns in (("log_time_ns", log_time_ns), ("publish_time_ns", sent_ns)):
            if not 0 <= time_ns < 2**63:
                raise DatasetError(f"{name}: {time_ns} is not a time since 1970")
        return Message(self._channels[topic], log_time_ns, data, sent_ns, sequence & 0xFFFFFFFF)

    def write_chunk(self, messages: Sequence[Message]) -> None:
        """Append messages as one chunk: afterwards, either all of it is in the file or nothing."""
        for message in messages:
            self._writer.add_message(
                message.channel_id, message.log_time, message.data, message.publish_time, message.sequence
            )
        self._commit()

    def write_attachment(self, attachment: Attachment) -> None:
        """Append a file of others that belongs to the recording."""
        self._writer.add_attachment(**vars(attachment))
        self._commit()

    def write_metadata(self, name: str, values: dict[str, str]) -> None:
        """Append named texts; of several with the same name the last is valid."""
        self._writer.add_metadata(name, values)
        self._commit()

    @property
    def removed(self) -> bool:
        """Whether the path no longer leads to the open file: it was removed, moved, or its file system unmounted."""
        if self._fd < 0:
            return False
        try:
            status = self.path.stat()
        except OSError:
            return True
        return not os.path.samestat(status, os.fstat(self._fd))

    @property
    def free_bytes(self) -> int:
        """Space on the disk that holds the open file, for this user [bytes]; 0 once it is closed."""
        if self._fd < 0:
            return 0
        with system_errors(self.path):
            space = os.fstatvfs(self._fd)
        return space.f_bavail * space.f_frsize

    def sync(self) -> None:
        """Wait until everything written is on the disk; if this fails, the content of the disk is unknown."""
        with system_errors(self.path, "cannot be synchronised"):
            os.fdatasync(self._fd)

    def finish(self) -> None:
        """Write index and summary and close the file in any case; after a write that failed, it stays without them."""
        try:
            if not self._failed:  # else the writer knows of chunks that are not in the file
                self._writer.finish()
                self._commit()
                self.sync()
        finally:
            self.abandon()

    def abandon(self) -> None:
        """Close the file as it is; may be called more than once."""
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1

    def _commit(self) -> None:
        if self._fd < 0:
            raise FileError(self.path, "is closed")
        self._writer.flush()
        content = b"".join(self._parts)
        self._parts.clear()
        rest = memoryview(content)
        try:
            with system_errors(self.path):
                while rest:
                    rest = rest[os.write(self._fd, rest) :]
        except FileError:
            self._failed = True
            try:
                os.ftruncate(self._fd, self.size)  # remove the remains of the write
            except OSError:
                self.abandon()  # they stay: readers stop before them, and nothing may be written after them
            raise
        self.size += len(content)
