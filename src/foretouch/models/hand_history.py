# SPDX-License-Identifier: Apache-2.0
"""What the fingertips of one hand have read so far, of whatever object, and the file that keeps it across restarts.

`HandHistory` compares readings with the predictions of one model and feeds the differences to a `SensorTracker`. Another object at hand
forgets the object's part and keeps the state of the sensors.

The file of a hand is a safetensors file that is replaced as a whole and holds a hash of its content. Its age needs no limit: while nothing is
read, the tracker's variance grows back to that of an unknown sensor.
"""

from __future__ import annotations

import fcntl
import hashlib
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from safetensors import SafetensorError
from safetensors.numpy import load

from foretouch.checked_files import read_bytes
from foretouch.cloud.geometry.limits import DEFAULT_LIMITS, ObjectLimits
from foretouch.errors import FileError, ModelError, TactileError
from foretouch.models.files import packed, replace_files
from foretouch.models.touch_model import History, TouchModel
from foretouch.models.tracker import SensorTracker
from foretouch.tactile import check_touch
from foretouch.types import Cloud, Grasp, Touch

VERSION: Final = 1
"""Of the file's format."""

_LARGEST: Final = 10_000_000  # bytes; a file has about 200 kB
_TARE_EVERY_NS: Final = 60 * 10**9  # more often, the error that successive tares share would be counted as many
_RECENT_TARE_NS: Final = 60 * 10**9  # a newer tare is named as the reference of a prediction


class HandHistory:
    """Readings of one hand, compared with the predictions of one model. Not thread-safe.

    Args:
        model: Its calibration has the parameters of a tracker.
        tracker: What was read before; by default nothing.

    Raises:
        ModelError: If the model has no tracker.

    Attributes:
        touches: Touches of the current object.
        restarts: Fingers that were restarted, since readings showed another sensor or a jump: thumb and middle finger.
    """

    def __init__(self, model: TouchModel, tracker: SensorTracker | None = None) -> None:
        fresh = model.new_tracker()
        self.model = model
        self.tracker = fresh if tracker is None else tracker
        self.restarts: dict[str, int] = {}
        self._tare_ns: int | None = None

    @property
    def touches(self) -> int:
        """Touches of the current object."""
        return self.tracker.touches

    def add_tare(self, stamp_ns: int, tare: Touch, *, now_ns: int | None = None) -> tuple[str, ...]:
        """Add a reading without contact; one within a minute of the last is left out, since their errors are the same.

        Args:
            stamp_ns: When it was taken [ns].
            tare: [counts].
            now_ns: Wall clock, which the stamp may not be ahead of [ns]; None: not checked.

        Returns:
            Fingers that were restarted: a jump or another sensor.

        Raises:
            TactileError: If it is not a reading of working sensors, or the stamp cannot be used.
        """
        if self._tare_ns is not None and 0 <= stamp_ns - self._tare_ns < _TARE_EVERY_NS:
            return ()
        restarted = self.tracker.add_tare(stamp_ns, self.model.tare_offset(tare), now_ns=now_ns)
        self._tare_ns = stamp_ns
        return self._counted(restarted)

    def add_touch(
        self,
        stamp_ns: int,
        cloud: Cloud,
        grasp: Grasp,
        reading: Touch,
        *,
        new_object: bool = False,
        now_ns: int | None = None,
        limits: ObjectLimits = DEFAULT_LIMITS,
    ) -> tuple[str, ...]:
        """Add the reading of an executed grasp.

        Args:
            stamp_ns: When it was taken [ns].
            cloud: The cloud that the grasp was planned on.
            grasp: As executed.
            reading: Both fingers in contact [counts].
            new_object: Whether it is another object than before.
            now_ns: As of `add_tare`.
            limits: Range and size of objects.

        Returns:
            As `add_tare`.

        Raises:
            TactileError: If the reading is not that of working sensors, or the stamp cannot be used.
            CloudError: If the cloud cannot be used.
            GraspError: If no hand can execute the grasp.
        """
        faults = check_touch(reading).faults
        if faults:
            raise TactileError(f"touched: {faults[0]}")
        estimate = self.model.estimate_executed(cloud, [grasp], limits)
        if new_object or not self.touches:
            self.tracker.start_object(known=bool(estimate.in_distribution[0]))
        return self._counted(
            self.tracker.add_touch(stamp_ns, reading.vector(), estimate.counts[0], now_ns=now_ns)
        )

    def start_object(self) -> None:
        """Another object is at hand: forget the touches of the last one, keep the state of the sensors."""
        self.tracker.start_object()

    def at(self, stamp_ns: int, *, same_object: bool) -> History:
        """The readings for predictions at a time [ns], of the current object or of one that was not touched."""
        tared = self._tare_ns is not None and stamp_ns - self._tare_ns < _RECENT_TARE_NS
        return History(self.tracker, stamp_ns, same_object=same_object, tare=tared)

    def _counted(self, restarted: tuple[str, ...]) -> tuple[str, ...]:
        for finger in restarted:
            self.restarts[finger] = self.restarts.get(finger, 0) + 1
        return restarted


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
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._lock = os.open(lock, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
        except OSError as err:
            raise FileError(path, f"cannot be written: {err.strerror or err}") from err
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

    def read(self, model: TouchModel) -> SensorTracker | None:
        """What was read before; None without a file.

        Raises:
            FileError: If the file is damaged, or of another version, hand or model.
        """
        return read_history(self.path, model, self._hand) if self.path.exists() else None

    def write(self, tracker: SensorTracker, model: TouchModel) -> None:
        """Replace the file.

        Raises:
            FileError: If it cannot be written; the one before is kept.
        """
        replace_files({self.path: history_content(tracker, model, self._hand)})

    def set_aside(self) -> Path:
        """Rename a file that cannot be used, so that it is not overwritten, and return its new path."""
        kept = self.path.with_name(self.path.name + ".unused")
        self.path.replace(kept)
        return kept


def history_content(tracker: SensorTracker, model: TouchModel, hand: str) -> bytes:
    """The content of a hand's file."""
    tensors = {f"tracker/{name}": value for name, value in tracker.to_tensors().items()}
    tensors |= {"version": np.array([VERSION], np.int64), "hand": _text(hand), "model": _text(model.name)}
    sha256 = hashlib.sha256(packed(tensors)[0]).digest()
    return packed({**tensors, "sha256": np.frombuffer(sha256, np.uint8)})[0]


def read_history(path: Path, model: TouchModel, hand: str | None = None) -> SensorTracker:
    """The tracker in a hand's file.

    Args:
        path: The file.
        model: Whose predictions the readings were compared with.
        hand: Name of the hand; None accepts any.

    Raises:
        FileError: If the file is absent or damaged, or of another version, hand or model.
        ModelError: If the model has no tracker.
    """
    fresh = model.new_tracker()
    try:
        tensors = load(read_bytes(path, _LARGEST))
    except (SafetensorError, ValueError, KeyError, TypeError, AttributeError) as err:
        raise FileError(path, f"damaged: {' '.join(str(err).split())}") from err
    found = tensors.pop("sha256", None)
    if found is None or bytes(found) != hashlib.sha256(packed(tensors)[0]).digest():
        raise FileError(path, "damaged: its content has another hash")
    version = tensors.get("version", np.array([-1]))
    if version.shape != (1,) or int(version[0]) != VERSION:
        raise FileError(path, f"version: {version.tolist()} is not [{VERSION}]")
    for name, own in (("hand", hand), ("model", model.name)):
        stored = bytes(tensors.get(name, _text(""))).decode("utf-8", "replace")
        if own is not None and stored != own:
            raise FileError(path, f"{name}: is of {stored!r}, not of {own!r}")
    try:
        return SensorTracker.from_tensors(fresh.parameters, _under("tracker/", tensors))
    except ModelError as err:
        raise FileError(path, str(err)) from err


def _text(text: str) -> npt.NDArray[np.uint8]:
    return np.frombuffer(text.encode(), np.uint8)


def _under(prefix: str, tensors: Mapping[str, npt.NDArray[Any]]) -> dict[str, npt.NDArray[Any]]:
    return {name.removeprefix(prefix): array for name, array in tensors.items() if name.startswith(prefix)}
