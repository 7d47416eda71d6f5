# SPDX-License-Identifier: Apache-2.0
"""The MCAP file of one recording session: its topics, its message counts, and how often it is put on the disk."""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from foretouch import __version__
from foretouch.config import Settings, setting
from foretouch.dataset.disk import sync_folder
from foretouch.dataset.record import Identity
from foretouch.dataset.recording.definitions import Definitions
from foretouch.dataset.recording.mcap_file import McapFile, McapMessage
from foretouch.dataset.recording.message_counts import MessageCounts
from foretouch.dataset.recording.messages import ABOUT, COUNTS, SCHEMA_VERSION
from foretouch.errors import DatasetError


@dataclass(frozen=True, kw_only=True)
class RecordingConfig(Settings):
    """How often a recording is written to the disk, and when it ends for lack of space."""

    fsync_samples: int = setting(
        1, "Samples between two waits for the disk; 0 leaves it to the system: a power cut then costs up to half a minute",
        minimum=0,
    )  # fmt: skip
    fsync_s: float = setting(
        5.0, "Longest time between two waits for the disk while messages arrive; 0 never waits", unit="s", minimum=0.0
    )
    chunk_s: float = setting(
        0.5, "Longest time that messages are collected before they are written", unit="s", minimum=0.0
    )
    chunk_bytes: int = setting(
        4_000_000, "Largest amount of messages collected before they are written", unit="bytes", minimum=1
    )
    min_free_mb: float = setting(500.0, "Free disk space at which the recording ends", unit="MB", minimum=0.0)
    accounts_s: float = setting(5.0, "Time between message counts in the file", unit="s", minimum=0.1)


class SessionFile:
    """The file of a new recording session. Not thread-safe.

    Args:
        path: The file; must not exist.
        identity: Hand and camera.

    Raises:
        FileError: If it exists or cannot be written; the same applies to all methods that write.
    """

    def __init__(self, path: Path, identity: Identity) -> None:
        self._mcap = McapFile(path, f"foretouch {__version__}")
        self._definitions = Definitions()
        self._channels: dict[str, int] = {}
        self._types: dict[str, str] = {}
        self._unsynced_samples = 0
        self._synced_s = self._counted_s = time.monotonic()
        try:
            self._mcap.write_metadata(ABOUT, _about(path.stem, identity))
        except BaseException:
            self.abandon()
            raise

    @property
    def path(self) -> Path:
        """The file."""
        return self._mcap.path

    @property
    def size(self) -> int:
        """Its size so far [bytes]."""
        return self._mcap.size

    @property
    def removed(self) -> bool:
        """See `McapFile.removed`."""
        return self._mcap.removed

    @property
    def free_bytes(self) -> int:
        """See `McapFile.free_bytes`."""
        return self._mcap.free_bytes

    def reopen(self) -> BinaryIO:
        """See `McapFile.reopen`."""
        return self._mcap.reopen()

    def declares(self, topic: str, type_name: str) -> bool:
        """Whether a topic is declared.

        Raises:
            DatasetError: If it is declared with another type.
        """
        if topic in self._channels and self._types[topic] != type_name:
            raise DatasetError(f"{topic}: holds {self._types[topic]}, not {type_name}")
        return topic in self._channels

    def declare(self, topic: str, type_name: str, definition: str | None = None, qos: str = "") -> None:
        """Declare a topic; the definition of its type is looked up if `definition` is None.

        Raises:
            DatasetError: If the definition cannot be found.
        """
        if definition is not None:
            self._definitions.register(type_name, definition)
        text = self._definitions.text(type_name)
        self._channels[topic] = self._mcap.add_channel(topic, type_name, text, qos)
        self._types[topic] = type_name

    def channel(self, topic: str) -> int:
        """The number of a topic.

        Raises:
            DatasetError: If it was not declared.
        """
        if topic not in self._channels:
            raise DatasetError(f"{self.path}: {topic} was not declared by add_topic")
        return self._channels[topic]

    def write(self, messages: Sequence[McapMessage], samples: int = 0) -> None:
        """Append messages, `samples` of which are samples, as one chunk."""
        self._mcap.write_chunk(messages)
        self._unsynced_samples += samples

    def write_due(self, config: RecordingConfig, counts: MessageCounts) -> None:
        """Write the message counts and wait for the disk, if either is due."""
        now = time.monotonic()
        if now - self._counted_s >= config.accounts_s:
            self._counted_s = now
            self._write_counts(counts)
        due = 0 < config.fsync_samples <= self._unsynced_samples
        if due or 0 < config.fsync_s <= now - self._synced_s:
            self.sync()

    def sync(self, folder: Path | None = None) -> None:
        """Wait until everything is on the disk, including the names in `folder` if one is given."""
        self._mcap.sync()
        if folder is not None:
            sync_folder(folder)
        self._unsynced_samples = 0
        self._synced_s = time.monotonic()

    def finish(self, counts: MessageCounts) -> None:
        """Write the last message counts and the index and close the file; it is closed in any case."""
        try:
            self._write_counts(counts)
            self._mcap.finish()
        finally:
            self._mcap.abandon()

    def abandon(self) -> None:
        """Close the file as it is; may be called more than once."""
        self._mcap.abandon()

    def _write_counts(self, counts: MessageCounts) -> None:
        self._mcap.write_metadata(COUNTS, counts.to_mapping())


def _about(session: str, identity: Identity) -> dict[str, str]:
    about = {"schema_version": str(SCHEMA_VERSION), "foretouch": __version__, "session": session}
    for name, values in (("hand", identity.hand), ("camera", identity.camera)):
        about |= {f"{name}.{key}": value for key, value in sorted(values.items())}
    return about
