# SPDX-License-Identifier: Apache-2.0
"""Records a session into a dataset without losing any acknowledged sample.

A session in short, from a node or any other program that has serialised messages::

    identity = Identity(hand={"name": "shadow-rh", "serial": "1234"}, camera={"name": "D415", "serial": "5678"})
    with RecordingWriter("grasps", identity) as writer:
        writer.add_topic("/rh/tactile", "foretouch_msgs/msg/BiotacAll")
        writer.receive("/rh/tactile")                  # on arrival
        writer.write("/rh/tactile", cdr, log_time_ns)  # or writer.drop("/rh/tactile", "queue full")
        sample_id = writer.append(sample)
    print(writer.counts.topics)

Guarantees:

- `append` returns when the sample was passed to the system, as one chunk in one call: a kill -9 at any later
  instant loses nothing of it. By default it is also on the disk (`fsync_samples`), safe from a power cut.
- Messages of `write` are collected for at most 0.5 s or 4 MB; `flush` writes them immediately.
- received = written + dropped, by topic; the counts are stored in the file.
- When the disk is almost full, or fails, the session ends with an error that says so, and the file holds everything
  that was acknowledged.
- When the file is removed while it is written, `output.removed` is true at once, and `close` counts its messages and
  samples as dropped.
"""

import threading
import time
from collections.abc import Callable
from contextlib import ExitStack, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, Self
from uuid import uuid4

from mcap.records import Message

from foretouch import __version__
from foretouch.base.files import PART, system_errors
from foretouch.config import Settings, setting
from foretouch.dataset.identity import Identity, check_name, id_number, numbered_id
from foretouch.dataset.recordings.edits import Edit, append_edit
from foretouch.dataset.recordings.folder import SESSIONS, new_session_path, opened_to_write, restate, session_files
from foretouch.dataset.recordings.mcap import McapFile
from foretouch.dataset.recordings.reader import known_sessions, recorded_ids
from foretouch.dataset.recordings.records import MessageCounts
from foretouch.dataset.recordings.sample_codec import (
    ABOUT,
    COUNTS,
    SAMPLE_TOPIC,
    SAMPLE_TYPE,
    SCHEMA_VERSION,
    encode_sample,
    sample_types,
)
from foretouch.errors import DatasetError, FileError, ForetouchError
from foretouch.tactile.channels import BIOTAC_SP
from foretouch.tactile.description import Sensor
from foretouch.types import Sample

_MB: Final = 1_000_000
_CHUNK_BYTES: Final = 4_000_000  # largest amount of messages that is collected before it is written
_FSYNC_S: Final = 5.0  # longest time between two waits for the disk while messages arrive
CHUNK_S = 0.5  # longest time that messages are collected before they are written
COUNTS_S = 5.0  # time between message counts in the file


@dataclass(frozen=True, kw_only=True)
class RecordingConfig(Settings):
    """How often a recording is written to the disk, and when it ends for lack of space."""

    fsync_samples: int = setting(
        1, "Samples between two waits for the disk, which end after 5 s too; 0 leaves it to the system: a power cut then "
        "costs up to half a minute", bounds=(0, 1_000_000),
    )  # fmt: skip
    min_free_mb: float = setting(500.0, "Free disk space at which the recording ends", bounds=(0.0, 1e9))


class RecordingWriter:
    """One recording session; a context manager. Thread-safe.

    Args:
        path: The dataset: created if it does not exist, else the session is added to it.
        identity: Hand and camera; must equal the dataset's.
        config: Settings.
        sensor: Which is read, by default the BioTac SP; must be the dataset's sensor.
        whole: Whether the session appears in the dataset at its end, or not at all if the block ends with an exception or the disk
            is full. Otherwise each sample is there once it was appended.

    Raises:
        FileError: If another process records into the dataset, or it is of another hand, camera, sensor, version or format,
            or cannot be written.
    """

    def __init__(
        self,
        path: str | Path,
        identity: Identity,
        config: RecordingConfig | None = None,
        *,
        sensor: Sensor | None = None,
        whole: bool = False,
    ) -> None:
        self.path = Path(path)
        self._whole = whole
        self.identity = identity
        self.sensor = sensor or BIOTAC_SP
        self.config = config or RecordingConfig()
        self.counts = MessageCounts()  # by topic; samples are counted under `SAMPLE_TOPIC`
        self.samples = 0  # appended
        self.labelled = 0  # appended with a touch
        # Called once before the last counts, however the session ends: the owner counts what it still keeps in queues.
        self.before_end: Callable[[], None] = lambda: None
        self._removal = ""  # what is lost with a file that was removed
        self.closed = False  # whether the session has ended, by `close` or because the disk is full or failed
        self._unsynced_samples = 0
        self._guard = threading.RLock()
        self._pending: list[tuple[str, Message]] = []
        self._pending_bytes = 0
        with ExitStack() as stack:
            stack.enter_context(opened_to_write(self.path, identity, self.sensor))
            self._ids = recorded_ids(self.path)  # each is used once, and numbers continue those before
            self._last_number = max(map(id_number, self._ids), default=0)
            self.file = new_session_path(self.path)
            part = self.file.with_name(f"{self.file.name}{PART}")
            for left in self.path.glob(f"session-*{PART}"):  # of a process that was killed, since this one has the lock
                left.unlink()
            if whole:
                stack.callback(part.unlink, missing_ok=True)
            self.output = McapFile(
                part if whole else self.file
            )  # once it is `removed`, nothing more should be recorded
            stack.callback(self.output.abandon)
            self._session = uuid4().hex
            self.output.write_metadata(ABOUT, {**_about(self.file.stem, identity), "id": self._session})
            self.output.declare(SAMPLE_TOPIC, SAMPLE_TYPE, sample_types().text(SAMPLE_TYPE))
            self._sync()
            if not whole:
                self._state()
            self._release = stack.pop_all()
        self._flushed_s = self._counted_s = time.monotonic()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if self._whole and kind is not None:
            self._discard()
        self.close()

    @property
    def free_bytes(self) -> int:
        """Disk space available to this user, less `min_free_mb` [bytes]; the session ends at 0. 0 after its end."""
        return max(0, self.output.free_bytes - int(self.config.min_free_mb * _MB))

    def add_topic(self, topic: str, type_name: str) -> None:
        """Declare a topic, before its first message.

        Args:
            topic: Its full name.
            type_name: Of its messages, such as `sensor_msgs/msg/PointCloud2`.

        Raises:
            DatasetError: If the type has no definition, or the topic another type.
        """
        with self._guard:
            known = self.output.types.get(topic)
            if known is None:
                self._require_open()
                self.output.declare(topic, type_name, sample_types().text(type_name))
            elif known != type_name:
                raise DatasetError(f"{topic}: holds {known}, not {type_name}")

    def receive(self, topic: str, count: int = 1) -> None:
        """Count messages on arrival; each must later be written or dropped.

        Args:
            topic: That they came on.
            count: Number of messages.
        """
        with self._guard:
            self.counts.topic(topic).received += count

    def drop(self, topic: str, reason: str, count: int = 1) -> None:
        """Count discarded messages.

        Args:
            topic: That they came on.
            reason: A few constant words, such as "queue full".
            count: Number of messages.
        """
        with self._guard:
            self.counts.topic(topic).drop(reason, count)

    def lose(self, topic: str, total: int) -> None:
        """Update the number of messages that the middleware lost before they were received.

        Args:
            topic: That they were sent on.
            total: Number so far; a smaller one than before changes nothing.
        """
        if total > 0:
            with self._guard:
                counts = self.counts.topic(topic)
                counts.lost = max(counts.lost, total)

    def write(
        self,
        topic: str,
        data: bytes,
        log_time_ns: int,
        *,
        publish_time_ns: int | None = None,
        sequence: int | None = None,
    ) -> None:
        """Collect a serialised message; the next flush writes it to the file.

        Args:
            topic: A declared topic.
            data: The message in CDR, with its encapsulation header.
            log_time_ns: When it was received [ns]; clocks may jump.
            publish_time_ns: When it was sent [ns]; by default when it was received.
            sequence: Its number by the middleware; by default a count.

        Raises:
            DatasetError: If the topic is unknown or the time negative; the message is not counted.
            FileError: If the session has ended, or ends now because the disk is full or fails; the collected messages
                are counted as dropped, with the reason.
        """
        with self._guard:
            self._require_open()
            if sequence is None:
                sequence = self.counts.topics[topic].written if topic in self.counts.topics else 0
            sent = log_time_ns if publish_time_ns is None else publish_time_ns
            self._pending.append((topic, self.output.message(topic, data, log_time_ns, sent, sequence)))
            self._pending_bytes += len(data)
            if self._pending_bytes >= _CHUNK_BYTES or time.monotonic() - self._flushed_s >= CHUNK_S:
                self.flush()

    def append(self, sample: Sample) -> str:
        """Write a sample in its own chunk, after all messages before it, and return its id.

        An empty id becomes `<object>/<number>`, the number one above the dataset's highest. The sample is now as safe as
        `RecordingConfig` specifies.

        Raises:
            DatasetError: If the sample breaks a rule or its id is taken; the session continues.
            FileError: If the session has ended, or ends now; the sample is then not acknowledged.
        """
        with self._guard:
            self._require_open()
            sample = self._with_id(sample)
            data = encode_sample(sample, self.identity, self.sensor)
            message = self.output.message(SAMPLE_TOPIC, data, time.time_ns(), sample.stamp_ns, self.samples)
            self.counts.topic(SAMPLE_TOPIC).received += 1
            self._write_pending()
            self._pending = [(SAMPLE_TOPIC, message)]
            self._pending_bytes = len(data)
            self._write_pending()
            self._unsynced_samples += 1
            self._ids.add(sample.id)
            self._last_number = max(self._last_number, id_number(sample.id))
            self.samples += 1
            self.labelled += sample.touch is not None
            self._after_write()
            return sample.id

    def edit(self, edit: Edit) -> int:
        """Append an edit to the dataset's log and return its number; a `FileError` if it cannot be written, or the session has ended."""
        with self._guard:
            self._require_open()
            return append_edit(self.path, edit)

    @property
    def objects(self) -> set[str]:
        """Names of the objects of the dataset, as they were recorded."""
        return {name.rpartition("/")[0] for name in self._ids}

    def flush(self) -> None:
        """Write the collected messages; a `FileError` if the session has ended, or ends now."""
        with self._guard:
            self._require_open()
            self._write_pending()
            self._after_write()

    def close(self) -> None:
        """Write the collected messages, the counts and the index, and end the session; may be called more than once.

        Raises a `FileError` if the disk is full or fails: everything that was acknowledged is in the file. If the file
        was removed, the message names what is lost.
        """
        with self._guard:
            if self.closed:
                return
            self._write_pending()
            self._end("not written when the session ended")
            if self._removal:
                raise FileError(self.file, self._removal)

    def _with_id(self, sample: Sample) -> Sample:
        check_name(sample.object, "object")
        if not sample.id:
            sample = replace(sample, id=numbered_id(sample.object, self._last_number + 1))
        if sample.id in self._ids:
            cure = (
                "give another id, or write to another dataset; `foretouch dataset build` joins datasets with equal ids"
            )
            raise DatasetError(f"{self.path.name}: id {sample.id} is taken: {cure}")
        return sample

    def _require_open(self) -> None:
        if self.closed:
            raise FileError(self.file, "the session has ended")

    def _write_pending(self) -> None:
        if not self._pending:
            return
        if self.free_bytes < self._pending_bytes:
            self._stop(f"disk almost full: less than {self.config.min_free_mb:g} MB would be left", "disk full")
        self._guarded(lambda: self.output.write_chunk([message for _, message in self._pending]))
        for topic, _ in self._pending:
            self.counts.topic(topic).written += 1
        self._pending, self._pending_bytes = [], 0
        self._flushed_s = time.monotonic()

    def _after_write(self) -> None:
        """Write the message counts and wait for the disk, if either is due."""
        now = time.monotonic()
        if now - self._counted_s >= COUNTS_S:
            self._counted_s = now
            self._guarded(self._write_counts)
        every = self.config.fsync_samples
        if every and (self._unsynced_samples >= every or now - self._synced_s >= _FSYNC_S):
            self._guarded(self._sync)

    def _write_counts(self) -> None:
        self.output.write_metadata(COUNTS, self.counts.to_mapping())

    def _sync(self) -> None:
        self.output.sync()
        self._unsynced_samples = 0
        self._synced_s = time.monotonic()

    def _guarded(self, action: Callable[[], object]) -> None:
        """Write to the file; if that fails, the session ends with everything that was acknowledged."""
        try:
            action()
        except FileError as err:
            self._stop(err.rule, "write failed", err)

    def _stop(self, rule: str, reason: str, cause: ForetouchError | None = None) -> None:
        """End the session because the disk is full or failed."""
        self._pending, self._pending_bytes = [], 0
        if self._whole:
            self._discard()
            raise FileError(self.path, f"{rule}: nothing was added") from cause
        with suppress(FileError):  # no space for the index: the chunks remain, and `repair` creates one
            self._end(reason)
        kept = f"the session has ended, its {self.samples} samples are in the file"
        cure = "" if cause is None else "; run `foretouch dataset repair`"
        rest = self._removal or kept + cure
        raise FileError(self.file, f"{rule}: {rest}") from cause

    def _end(self, reason: str) -> None:
        self.closed = True
        self.before_end()
        for counts in self.counts.topics.values():
            counts.drop(reason, counts.pending)
        with self._release:
            if self.output.removed:
                self._removal = self._count_removed()
            else:
                self._write_counts()
                self.output.finish()
                if self._whole and (self.samples or not session_files(self.path)):
                    with system_errors(self.file):
                        self.output.path.rename(self.file)
                    self._state()

    def _state(self) -> None:
        """Let the manifest list the session."""
        restate(self.path, SESSIONS, {**known_sessions(self.path), self.file.name: self._session})

    def _discard(self) -> None:
        """End a session that appears as a whole, without it."""
        self.closed = True
        self._release.close()

    def _count_removed(self) -> str:
        """Count the content of a file that was removed as dropped; says what is lost."""
        samples = self.samples
        self.samples = 0
        self.labelled = 0
        messages = sum(counts.written for counts in self.counts.topics.values()) - samples
        for counts in self.counts.topics.values():
            counts.drop("file removed", counts.written)
            counts.written = 0
        return f"was removed during the recording: {samples} samples and {messages} messages are lost"


def _about(session: str, identity: Identity) -> dict[str, str]:
    about = {"schema_version": str(SCHEMA_VERSION), "foretouch": __version__, "session": session}
    for name, values in (("hand", identity.hand), ("camera", identity.camera)):
        about |= {f"{name}.{key}": value for key, value in sorted(values.items())}
    return about
