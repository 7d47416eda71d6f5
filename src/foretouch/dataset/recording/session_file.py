# SPDX-License-Identifier: Apache-2.0
"""The file of one session: its topics, its accounts, and how often it is put on the disk."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path

from foretouch import __version__
from foretouch.dataset.recording.accounts import Accounts
from foretouch.dataset.recording.definitions import Definitions
from foretouch.dataset.recording.folder import sync_folder
from foretouch.dataset.recording.mcap_file import McapFile, McapMessage
from foretouch.dataset.recording.messages import ABOUT, ACCOUNTS, SCHEMA_VERSION
from foretouch.dataset.recording.policy import RecordingConfig
from foretouch.dataset.recording.record import Identity
from foretouch.errors import DatasetError

__all__ = ["SessionFile"]


class SessionFile:
    """A new session of a dataset. Not thread-safe.

    Args:
        path: Of the file; must not exist.
        identity: Hand and camera.

    Raises:
        FileError: If it exists or cannot be written; so do all methods that write.
    """

    def __init__(self, path: Path, identity: Identity) -> None:
        self._mcap = McapFile(path, f"foretouch {__version__}")
        self._definitions = Definitions()
        self._channels: dict[str, int] = {}
        self._types: dict[str, str] = {}
        self._unsynced_samples = 0
        self._synced_s = self._accounted_s = time.monotonic()
        try:
            self._mcap.write_metadata(ABOUT, _about(path.stem, identity))
        except BaseException:
            self.abandon()
            raise

    @property
    def path(self) -> Path:
        """Of the file."""
        return self._mcap.path

    @property
    def size(self) -> int:
        """Bytes so far."""
        return self._mcap.size

    def declares(self, topic: str, type_name: str) -> bool:
        """Whether a topic is declared.

        Raises:
            DatasetError: If it is, with another type.
        """
        if topic in self._channels and self._types[topic] != type_name:
            raise DatasetError(f"{topic}: holds {self._types[topic]}, not {type_name}")
        return topic in self._channels

    def define(self, type_name: str, definition: str | None) -> str:
        """The definition of a type with those of all types in it; looked up where none is given.

        Raises:
            DatasetError: If it is found nowhere.
        """
        if definition is not None:
            self._definitions.learn(type_name, definition)
        return self._definitions.text(type_name)

    def declare(self, topic: str, type_name: str, text: str, qos: str) -> None:
        """Declare a topic; `text` is what `define` gave."""
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
        """Append messages as one chunk, so many samples among them."""
        self._mcap.write_chunk(messages)
        self._unsynced_samples += samples

    def keep_up(self, config: RecordingConfig, accounts: Accounts) -> None:
        """Write accounts and wait for the disk, where either is due."""
        now = time.monotonic()
        if now - self._accounted_s >= config.accounts_s:
            self._accounted_s = now
            self._account(accounts)
        due = 0 < config.fsync_samples <= self._unsynced_samples
        if due or 0 < config.fsync_s <= now - self._synced_s:
            self.sync()

    def sync(self, folder: Path | None = None) -> None:
        """Wait until all is on the disk, the names in a folder too where one is given."""
        self._mcap.sync()
        if folder is not None:
            sync_folder(folder)
        self._unsynced_samples = 0
        self._synced_s = time.monotonic()

    def finish(self, accounts: Accounts) -> None:
        """Write the last accounts and the index and close the file; it is closed in any case."""
        try:
            self._account(accounts)
            self._mcap.finish()
        finally:
            self._mcap.abandon()

    def abandon(self) -> None:
        """Close the file as it is; more than once does no harm."""
        self._mcap.abandon()

    def _account(self, accounts: Accounts) -> None:
        self._mcap.write_metadata(ACCOUNTS, accounts.to_mapping())


def _about(session: str, identity: Identity) -> dict[str, str]:
    facts = {"schema_version": str(SCHEMA_VERSION), "foretouch": __version__, "session": session}
    for name, values in (("hand", identity.hand), ("camera", identity.camera)):
        facts |= {f"{name}.{fact}": value for fact, value in sorted(values.items())}
    return facts
