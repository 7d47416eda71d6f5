# SPDX-License-Identifier: Apache-2.0
"""Keeps the readings of a named hand in its file: read at the start, written aside by a thread. No node."""

import fcntl
import os
import re
import threading
import time
from collections.abc import Callable
from pathlib import Path

from foretouch.base.files import free_name, open_own, system_errors
from foretouch.errors import ConfigError, FileError, described
from foretouch.models.touch_model import History, TouchModel


class HistoryFile:
    """The file of one hand, which one process at a time may write.

    Args:
        path: The file; its folder is made.
        hand: Name of the hand, which the file must be of.

    Raises:
        FileError: If the folder cannot be written, or another process uses the file.
    """

    def __init__(self, path: Path, hand: str) -> None:
        self.path = path
        self._hand = hand
        lock = path.with_name(path.name + ".lock")
        with system_errors(path, "cannot be written"):
            path.parent.mkdir(parents=True, exist_ok=True)
        self._lock = open_own(lock, os.O_RDWR)
        try:
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as err:
            os.close(self._lock)
            raise FileError(path, "is used by another process") from err

    def close(self) -> None:
        """Let other processes use the file."""
        if self._lock >= 0:
            os.close(self._lock)
            self._lock = -1

    def read(self, model: TouchModel) -> History | None:
        """Return what was read before; None without a file.

        Raises:
            FileError: If the file is damaged, or of another version, sensor, hand or model.
        """
        if self.path.is_symlink() or self.path.exists():
            return History.load(self.path, model, self._hand)
        return None

    def write(self, history: History) -> None:
        """Replace the file.

        Raises:
            FileError: If it cannot be written; the one before is kept.
        """
        history.save(self.path, self._hand)

    def set_aside(self) -> Path:
        """Rename a file that cannot be used to a name that no file has, and return its new path.

        Raises:
            FileError: If it cannot be renamed.
        """
        kept = free_name(self.path, "unused")
        with system_errors(self.path, "cannot be renamed"):
            self.path.rename(kept)
        return kept


class HistoryKeeper:
    """The history of a hand, with its file in `folder` ("" for the default) if the hand has a name.

    Readings are compared with the predictions of `model`. A file that cannot be used does not stop the node: it is set
    aside, or not written, and `fault` says why. `lock` is the lock of `history`.

    Raises:
        ConfigError: If the name of the hand cannot name a file.
    """

    def __init__(
        self,
        model: TouchModel,
        hand: str = "",
        folder: str = "",
        *,
        now_ns: Callable[[], int] = time.time_ns,
        info: Callable[[str], object] = print,
        warn: Callable[[str], object] = print,
    ) -> None:
        self.lock = threading.Lock()
        self._now_ns = now_ns
        self.fault = ""
        self._warn = warn
        self._changed, self._closed = threading.Event(), threading.Event()
        self._file: HistoryFile | None = None
        self._thread: threading.Thread | None = None
        history = None
        if hand:
            try:
                self._file = HistoryFile(_path(folder, hand), hand)
                history = self._read(self._file, model, info)
            except FileError as err:
                self._fail(f"{err}; readings are not kept")
        self.history = history or History(model)
        if self._file is not None:
            self._thread = threading.Thread(target=self._run, args=(self._file,), name="history", daemon=True)
            self._thread.start()

    def changed(self) -> None:
        """There may be new readings."""
        self._changed.set()

    def notes(self) -> dict[str, str]:
        """Entries for /diagnostics."""
        read = self.history.tracker.evidence(self._now_ns())
        age = "none" if read.reading_age_s is None else f"{read.reading_age_s:.1f}"
        values = {"history.readings": str(read.readings), "history.age_s": age}
        values |= {f"history.restarts.{finger}": str(count) for finger, count in self.history.restarts.items()}
        kept = self.fault or "none: hand_name is empty, so that readings are forgotten when the node ends"
        values["history.file"] = str(self._file.path) if self._file else kept
        return values | ({"history.fault": self.fault} if self.fault else {})

    def close(self) -> None:
        """Write what is not written yet, and let other processes use the file."""
        if self._thread is not None:
            self._closed.set()
            self._changed.set()
            self._thread.join()
            self._thread = None
        if self._file is not None:
            self._file.close()

    def _read(self, file: HistoryFile, model: TouchModel, info: Callable[[str], object]) -> History | None:
        try:
            history = file.read(model)
        except FileError as err:
            self._warn(f"history: {err}; renamed to {file.set_aside().name}")
            history = None
        known = f"{history.tracker.evidence(self._now_ns()).readings} readings" if history else "does not exist yet"
        info(f"history: {file.path}: {known}")
        return history

    def _run(self, file: HistoryFile) -> None:
        written = (-1, -1)
        while not self._closed.is_set():
            self._changed.wait()
            self._changed.clear()
            written = self._write(file, written)
            self._closed.wait(0.5)  # a crash loses at most a second
        self._write(file, written)

    def _write(self, file: HistoryFile, written: tuple[int, int]) -> tuple[int, int]:
        """Write if the history is another one than the `written` revision; gives the revision that is written now."""
        with self.lock:
            history = self.history.copy()
        if history.revision == written:
            return written
        try:
            file.write(history)
        except Exception as err:  # noqa: BLE001  the thread must go on, and try again with the next reading
            self._fail(str(err) if isinstance(err, FileError) else f"{file.path}: {described(err)}")
            return written
        self.fault = ""
        return history.revision

    def _fail(self, fault: str) -> None:
        if fault != self.fault:
            self._warn(f"history: {fault}")
        self.fault = fault


def _path(folder: str, hand: str) -> Path:
    """Return the file of a hand."""
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}", hand):
        raise ConfigError(
            f"hand: {hand!r} must be 1 to 64 letters, digits, '_', '-' or '.', and begin with a letter or digit"
        )
    state = Path(os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state")
    return (Path(folder).expanduser() if folder else state / "foretouch") / f"{hand}.safetensors"
