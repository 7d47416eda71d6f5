# SPDX-License-Identifier: Apache-2.0
"""Records a session into a dataset, and loses nothing that it acknowledged.

A session in short, from a node or from anything else that can hand over serialised messages::

    identity = Identity(hand={"name": "shadow-rh", "serial": "1234"}, camera={"name": "D415", "serial": "5678"})
    with RecordingWriter("grasps", identity) as writer:
        writer.add_topic("/rh/tactile", "foretouch_msgs/msg/BiotacAll")
        writer.receive("/rh/tactile")                  # on arrival
        writer.write("/rh/tactile", cdr, log_time_ns)  # or writer.drop("/rh/tactile", "queue full")
        sample_id = writer.append(SampleRecord(sample=sample, outcome="success"))
    print(writer.accounts.topics)

What is promised:

- `append` returns when the sample is with the system, as one chunk written in one piece: a kill -9 at any later
  instant loses nothing of it. By default it is also on the disk (`fsync_samples`), so that a power cut does not either.
- Messages of `write` are collected for at most `chunk_s` or `chunk_bytes`; `flush` hands them over at once.
- received = written + dropped, by topic; the accounts stand in the file.
- When the disk is almost full, or fails, the session ends with an error that says so, and the file holds all that
  was acknowledged.
"""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack, suppress
from pathlib import Path
from types import TracebackType
from typing import Final, Self

from foretouch.dataset.recording.accounts import Accounts
from foretouch.dataset.recording.folder import new_session_path, opened_to_write
from foretouch.dataset.recording.mcap_file import McapMessage
from foretouch.dataset.recording.messages import SAMPLE_TOPIC, SAMPLE_TYPE, encode_sample
from foretouch.dataset.recording.policy import RecordingConfig
from foretouch.dataset.recording.record import Identity, SampleRecord
from foretouch.dataset.recording.sample_names import SampleNames
from foretouch.dataset.recording.session_file import SessionFile
from foretouch.errors import FileError, ForetouchError

__all__ = ["RecordingWriter"]

_MB: Final = 1_000_000


class RecordingWriter:
    """One session; a context manager. Calls from several threads are put in a row.

    Args:
        path: Of the dataset: made if it is absent, else the session is added to it.
        identity: Hand and camera; they must be those of the dataset.
        config: Settings.

    Attributes:
        path: Of the dataset.
        accounts: What became of every message; the samples are among them, under `SAMPLE_TOPIC`.
        samples: Samples appended.
        labelled: Those with a touch.
        before_end: Called once before the last accounts are written, however the session ends: its owner books what
            became of messages that it still holds.

    Raises:
        FileError: If another process records into the dataset, or it is of another hand, camera or version, or of
            another kind, or cannot be written.
    """

    def __init__(self, path: str | Path, identity: Identity, config: RecordingConfig | None = None) -> None:
        self.path = Path(path)
        self.identity = identity
        self.config = config or RecordingConfig()
        self.accounts = Accounts()
        self.samples = 0
        self.labelled = 0
        self.before_end: Callable[[], None] = lambda: None
        self._closed = False
        self._guard = threading.RLock()
        self._pending: list[tuple[str, McapMessage]] = []
        self._pending_bytes = 0
        with ExitStack() as stack:
            stack.enter_context(opened_to_write(self.path, identity))
            self._names = SampleNames(self.path)
            self._file = SessionFile(new_session_path(self.path), identity)
            stack.callback(self._file.abandon)
            self._file.declare(SAMPLE_TOPIC, SAMPLE_TYPE, self._file.define(SAMPLE_TYPE, None), "")
            self._file.sync(self.path)
            self._release = stack.pop_all()
        self._flushed_s = time.monotonic()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @property
    def file(self) -> Path:
        """Of the session."""
        return self._file.path

    @property
    def closed(self) -> bool:
        """Whether the session has ended, by `close` or by a disk that is full or failed."""
        return self._closed

    @property
    def bytes_written(self) -> int:
        """Size of the session's file so far."""
        return self._file.size

    @property
    def free_bytes(self) -> int:
        """Space left to this user on the disk, down to `min_free_mb`; 0 where the session would end."""
        space = os.statvfs(self.path)
        return max(0, space.f_bavail * space.f_frsize - int(self.config.min_free_mb * _MB))

    def add_topic(self, topic: str, type_name: str, definition: str | None = None, *, qos: str = "") -> None:
        """Declare a topic, before its first message.

        Args:
            topic: Its name.
            type_name: Such as `sensor_msgs/msg/PointCloud2`.
            definition: Text of its `.msg`; by default it is looked up (see `Definitions`).
            qos: The offered QoS profiles as rosbag2 writes them, YAML.

        Raises:
            DatasetError: If the definition is not found, or the topic has another type.
            FileError: If the session has ended, or the disk fails.
        """
        with self._guard:
            if self._file.declares(topic, type_name):
                return
            self._require_open()
            text = self._file.define(type_name, definition)
            self._guarded(lambda: self._file.declare(topic, type_name, text, qos))

    def receive(self, topic: str, count: int = 1) -> None:
        """Book the arrival of messages, on arrival; each must later be written or dropped."""
        with self._guard:
            self.accounts.receive(topic, count)

    def drop(self, topic: str, reason: str, count: int = 1) -> None:
        """Book messages that are given up.

        Args:
            topic: Their topic.
            reason: In a few words that do not change, such as "queue full".
            count: How many.
        """
        with self._guard:
            self.accounts.drop(topic, reason, count)

    def lose(self, topic: str, total: int) -> None:
        """Book what the middleware has lost so far, in all; such messages are no part of those received."""
        with self._guard:
            self.accounts.lose(topic, total)

    def write(
        self,
        topic: str,
        data: bytes | memoryview,
        log_time_ns: int,
        *,
        publish_time_ns: int | None = None,
        sequence: int | None = None,
    ) -> None:
        """Take a serialised message of a declared topic; it is in the file after the next flush.

        Args:
            topic: Declared by `add_topic`.
            data: CDR with its encapsulation header; kept as it is, so do not change it.
            log_time_ns: When it was received [ns]; clocks may jump.
            publish_time_ns: When it was sent [ns]; by default the same.
            sequence: Of the middleware; by default a count.

        Raises:
            DatasetError: If the topic is unknown or the time negative; the message is not booked.
            FileError: If the session has ended, or ends now because the disk is full or fails; what was collected is
                booked as dropped, with the reason.
        """
        with self._guard:
            self._require_open()
            channel = self._file.channel(topic)
            if sequence is None:
                sequence = self.accounts.topics[topic].written if topic in self.accounts.topics else 0
            sent = log_time_ns if publish_time_ns is None else publish_time_ns
            self._pending.append((topic, McapMessage(channel, data, log_time_ns, sent, sequence)))
            self._pending_bytes += len(data)
            late = time.monotonic() - self._flushed_s >= self.config.chunk_s
            if late or self._pending_bytes >= self.config.chunk_bytes:
                self.flush()

    def append(self, record: SampleRecord, log_time_ns: int | None = None) -> str:
        """Write a sample in a chunk of its own, after all messages before it.

        Args:
            record: An empty id is filled in: `<object>/<number>`, the number one above the dataset's highest.
            log_time_ns: When it was complete [ns]; by default now.

        Returns:
            The id. From here on the sample is safe, as far as `RecordingConfig` says.

        Raises:
            DatasetError: If the sample breaks a rule or its id is taken; the session goes on.
            FileError: If the session has ended, or ends now; the sample is then not acknowledged.
        """
        with self._guard:
            self._require_open()
            record = self._names.named(record)
            data = encode_sample(record, self.identity)
            now = time.time_ns() if log_time_ns is None else log_time_ns
            sample = record.sample
            message = McapMessage(self._file.channel(SAMPLE_TOPIC), data, now, sample.stamp_ns, self.samples)
            self.accounts.receive(SAMPLE_TOPIC)
            self._write_pending()
            self._pending = [(SAMPLE_TOPIC, message)]
            self._pending_bytes = len(data)
            self._write_pending(samples=1)
            self._names.take(sample.id)
            self.samples += 1
            self.labelled += sample.touch is not None
            self._after_write()
            return sample.id

    def flush(self) -> None:
        """Write what was collected (raises as `write`)."""
        with self._guard:
            self._require_open()
            self._write_pending()
            self._after_write()

    def sync(self) -> None:
        """Write what was collected, and wait until all is on the disk (raises as `write`)."""
        with self._guard:
            self.flush()
            self._guarded(self._file.sync)

    def close(self) -> None:
        """Write what was collected, the accounts and the index, and end the session; more than once does no harm.

        Raises:
            FileError: If the disk is full or fails; all that was acknowledged is in the file.
        """
        with self._guard:
            if self._closed:
                return
            self._write_pending()
            self._end("not written when the session ended")

    def _require_open(self) -> None:
        if self._closed:
            raise FileError(self.file, "the session has ended")

    def _write_pending(self, samples: int = 0) -> None:
        if not self._pending:
            return
        if self.free_bytes < self._pending_bytes:
            self._stop(f"disk almost full: less than {self.config.min_free_mb:g} MB would be left", "disk full")
        self._guarded(lambda: self._file.write([message for _, message in self._pending], samples))
        for topic, _ in self._pending:
            self.accounts.write(topic)
        self._pending, self._pending_bytes = [], 0
        self._flushed_s = time.monotonic()

    def _after_write(self) -> None:
        self._guarded(lambda: self._file.keep_up(self.config, self.accounts))

    def _guarded(self, action: Callable[[], object]) -> None:
        """Do something with the file; if it fails, the session ends with all that was acknowledged."""
        try:
            action()
        except FileError as err:
            self._stop(err.rule, "write failed", err)

    def _stop(self, rule: str, reason: str, cause: ForetouchError | None = None) -> None:
        """End the session because the disk does not take more."""
        self._pending, self._pending_bytes = [], 0
        with suppress(FileError):  # no room for the index: the chunks stand, and `repair` makes one
            self._end(reason)
        raise FileError(
            self.file, f"{rule}: the session has ended, its {self.samples} samples are in the file"
        ) from cause

    def _end(self, reason: str) -> None:
        self._closed = True
        self.before_end()
        self.accounts.settle(reason)
        try:
            self._file.finish(self.accounts)
        finally:
            self._release.close()
