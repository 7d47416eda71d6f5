# SPDX-License-Identifier: Apache-2.0
"""What the fingertips of one hand have read so far, of whatever object, and the file that keeps it across restarts.

`History` compares readings with the predictions of one model and feeds the differences to a `SensorTracker`.
Another object forgets the last one's part and keeps the state of the sensors.

The file of a hand is a safetensors file that is replaced as a whole and holds a hash of its content. Its age needs no
limit: while nothing is read, the tracker's variance grows back to the variance of an unknown sensor.
"""

import copy
import fcntl
import hashlib
import os
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final, Self

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load

from foretouch.errors import FileError, ModelError, TactileError
from foretouch.files import free_name, open_own, read_bytes, replace_files, system_errors
from foretouch.models.files import packed, under
from foretouch.models.touch_model import Estimate, HasCloud, Snapshot, TouchModel
from foretouch.models.tracker import SensorTracker
from foretouch.tactile import BIOTAC
from foretouch.tactile.description import require_same
from foretouch.types import AnyArray, Cloud, Float64, Grasp, Predictions, Touch, UInt8
from foretouch.types.channels import Channels

VERSION: Final = 2
"""Of the file's format."""

SAME_OBJECT_M: Final = 0.02
"""How far an object may have moved, or changed in apparent size, since it was touched."""

_TRACKER: Final = "tracker/"
_LARGEST: Final = 10_000_000  # bytes; a file has about 200 kB
_TARE_EVERY_NS: Final = 60 * 10**9  # more often, the error that successive tares share would be counted as many


def place_and_size(cloud: Cloud) -> Float64:
    """Return (6,) float64 mean and standard deviation of the finite points of a cloud in x, y, z [m]; infinite without any."""
    points = cloud.xyz.reshape(-1, 3)
    points = points[np.isfinite(points).all(axis=1)].astype(np.float64)
    return np.concatenate([points.mean(axis=0), points.std(axis=0)]) if len(points) else np.full(6, np.inf)


class History:
    """Adapts the predictions of one model to the readings of one hand. Use it in one thread at a time.

    Args:
        model: A model with a calibration.

    Raises:
        ModelError: If the model has no calibration.

    Attributes:
        tracker: What the readings say about the sensors and the current object.
        signature: Frame and `place_and_size` of the current object at its last touch; None before its first.
        restarts: How often each finger was restarted, since its readings showed a jump or another sensor.
    """

    def __init__(self, model: TouchModel) -> None:
        self.model = model
        self.tracker = model.new_tracker()
        self.signature: tuple[str, Float64] | None = None
        self.restarts: dict[str, int] = {}
        self._tare_ns = -1
        self._tared = False  # after the last touch
        self._forgotten = 0

    @property
    def touches(self) -> int:
        """Touches of the current object."""
        return self.tracker.touches

    def add_tare(self, stamp_ns: int, tare: Touch, *, tdc: Float64 | None = None) -> tuple[str, ...]:
        """Add a reading without contact. One within a minute of the last is left out, since their errors are the same.

        Args:
            stamp_ns: When it was taken [ns].
            tare: The reading, in the unit of the sensor.
            tdc: (F,) temperature of the fingers [counts], where it is known.

        Returns:
            The fingers that were restarted, since their readings jumped.

        Raises:
            TactileError: If the reading is of another sensor or not of working ones, or the stamp cannot be used.
        """
        if self._tare_ns >= 0 and 0 <= stamp_ns - self._tare_ns < _TARE_EVERY_NS:
            return ()
        restarted = self.tracker.add_tare(stamp_ns, self.model.tare_offset(tare), tdc=tdc)
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
        estimate: Estimate | None = None,
        tdc: Float64 | None = None,
    ) -> tuple[str, ...]:
        """Add the reading of an executed grasp (`touched` is the simpler form).

        Args:
            stamp_ns: When it was taken [ns].
            cloud: The cloud that the grasp was planned on.
            grasp: As executed, in the frame of the cloud.
            reading: Both fingers in contact, in the unit of the sensor.
            new_object: Whether it is another object than before.
            estimate: The model's estimate of this grasp by `TouchModel.estimate_executed`; by default it is made here, and
                the camera is taken to look straight down on the table.
            tdc: (F,) temperature of the fingers [counts], where it is known.

        Returns:
            The fingers that were restarted, since their readings jumped.

        Raises:
            TactileError: If the reading is of another sensor or not of working ones, or the stamp cannot be used.
            CloudError: If the cloud cannot be used.
            GraspError: If no hand can execute the grasp.
        """
        values = self.model.usable_values(reading, "touched")
        estimate = estimate or self.model.estimate_executed(cloud, [grasp])
        if new_object or not self.touches:
            self.tracker.start_object(known=bool(estimate.in_distribution[0]))
        where = None if estimate.where is None else estimate.where[0]
        restarted = self.tracker.add_touch(stamp_ns, values, estimate.counts[0], tdc=tdc, where=where)
        self.signature = cloud.frame_id, place_and_size(cloud)
        return self._counted(restarted)

    def tare(self, reading: Touch, *, stamp_ns: int | None = None, tdc: Float64 | None = None) -> None:
        """Add a reading without contact.

        Args:
            reading: Both fingers at rest, in the unit of the sensor.
            stamp_ns: When it was taken [ns]; now if None.
            tdc: (F,) temperature of the fingers [counts], where it is known.

        Raises:
            TactileError: If the reading is of another sensor or not of working ones, or older than the last one.
        """
        self.add_tare(self._stamp(stamp_ns), reading, tdc=tdc)
        self._tared = True

    def touched(
        self,
        target: Cloud | HasCloud,
        grasp: Grasp,
        reading: Touch,
        *,
        stamp_ns: int | None = None,
        same_object: bool | None = None,
        tdc: Float64 | None = None,
    ) -> None:
        """Add the reading of an executed grasp.

        Args:
            target: The object as it was seen before, or its cloud.
            grasp: As executed, in the frame of its cloud.
            reading: Both fingers in contact, in the unit of the sensor.
            stamp_ns: When it was taken [ns]; now if None.
            same_object: Whether the object was touched last, too; by default by place and size.
            tdc: (F,) temperature of the fingers [counts], where it is known.

        Raises:
            TactileError: If the reading is of another sensor or not of working ones, or older than the last one.
            CloudError: If the cloud cannot be used.
            GraspError: If no hand can execute the grasp.
        """
        cloud = target if isinstance(target, Cloud) else target.cloud
        same = self.is_current(cloud, SAME_OBJECT_M) if same_object is None else same_object
        estimate = self.model.estimate_executed(cloud, [grasp], table=getattr(target, "plane", None))
        self.add_touch(self._stamp(stamp_ns), cloud, grasp, reading, new_object=not same, estimate=estimate, tdc=tdc)
        self._tared = False

    def predict(
        self,
        target: Cloud | HasCloud,
        grasps: Sequence[Grasp],
        *,
        stamp_ns: int | None = None,
        same_object: bool | None = None,
    ) -> Predictions:
        """Predict the readings at each grasp, adapted to all readings so far.

        Args:
            target: The object, or its cloud.
            grasps: K grasps in the frame of its cloud.
            stamp_ns: Time of the predictions [ns]; now if None.
            same_object: Whether it is the object that was touched last; by default by place and size.

        Returns:
            A row for each grasp, as of `TouchModel.predict`. `reference` names the strongest reading that it was adapted to.

        Raises:
            CloudError: If the cloud cannot be used.
        """
        cloud = target if isinstance(target, Cloud) else target.cloud
        same = self.is_current(cloud, SAME_OBJECT_M) if same_object is None else same_object
        read = self.snapshot(self._stamp(stamp_ns), same_object=same, tare=self._tared)
        return self.model.predict(target, grasps, history=read)

    def save(self, path: str | Path) -> None:
        """Write everything read so far to a file.

        Args:
            path: The file, which is replaced.

        Raises:
            FileError: If it cannot be written.
        """
        replace_files({Path(path): _content(self, "")})

    @classmethod
    def load(cls, path: str | Path, model: TouchModel) -> "History":
        """Read what `save` wrote, or the file of a hand of the graph.

        Args:
            path: The file.
            model: The model of the history.

        Raises:
            FileError: If the file is absent or damaged, or of another version, sensor, hand or model.
            ModelError: If the model has no calibration.
        """
        return read_history(Path(path), model)

    def _stamp(self, stamp_ns: int | None) -> int:
        return time.time_ns() if stamp_ns is None else stamp_ns

    def keep_to_clock(self, now_ns: int) -> bool:
        """Count readings from the future of a clock [ns] as taken now (see `SensorTracker.keep_to_clock`)."""
        return self.tracker.keep_to_clock(now_ns)

    def is_current(self, cloud: Cloud, same_object_m: float) -> bool:
        """Say whether the object of a cloud is the one that was touched last, by its place and size.

        Args:
            cloud: The object's points [m].
            same_object_m: Largest difference of the mean and of the deviation of its points [m].
        """
        if self.signature is None or self.signature[0] != cloud.frame_id:
            return False
        with np.errstate(invalid="ignore"):  # of a cloud without points, which is equal to no other object
            return bool((np.abs(place_and_size(cloud) - self.signature[1]) <= same_object_m).all())

    def start_object(self) -> None:
        """Forget the touches of the last object, and keep the state of the sensors: another object is touched from now on."""
        self.tracker.start_object()
        self.signature = None

    def forget(self) -> int:
        """Forget everything, such as after the sensors were exchanged. Returns the number of readings that were forgotten."""
        count = self.tracker.evidence(0).readings
        self.tracker = self.model.new_tracker()
        self.signature, self._tare_ns = None, -1
        self._forgotten += 1
        return count

    @property
    def revision(self) -> tuple[int, int]:
        """Changes with every reading, object and `forget`."""
        return self._forgotten, self.tracker.revision

    def copy(self) -> Self:
        """Return an independent history of the same readings."""
        twin = copy.copy(self)
        twin.tracker, twin.restarts = self.tracker.copy(), dict(self.restarts)
        return twin

    def to_tensors(self) -> dict[str, AnyArray]:
        """Return all of it as arrays, for a file."""
        frame, numbers = self.signature or ("", np.full(6, np.nan))
        own: dict[str, AnyArray] = {
            "signature": numbers,
            "frame": _text(frame),
            "tare_ns": np.array([self._tare_ns], np.int64),
        }
        return {**own, **{_TRACKER + name: value for name, value in self.tracker.to_tensors().items()}}

    @classmethod
    def from_tensors(cls, model: TouchModel, tensors: Mapping[str, AnyArray]) -> Self:
        """Make a history from `to_tensors`. It goes on to the bit as the history that wrote it.

        Raises:
            ModelError: Names an array that is missing or cannot be, or if it is of another model.
        """
        history = cls(model)
        for name, shape, dtype in (("signature", (6,), np.float64), ("tare_ns", (1,), np.int64)):
            array = tensors.get(name)
            if array is None or array.shape != shape or array.dtype != dtype:
                raise ModelError(f"{name}: is missing, or of another shape or type")
        history.tracker = SensorTracker.from_tensors(history.tracker.parameters, under(_TRACKER, tensors))
        if history.touches:
            history.signature = _read_text(tensors, "frame"), tensors["signature"]
        history._tare_ns = int(tensors["tare_ns"][0])
        return history

    def snapshot(self, stamp_ns: int, *, same_object: bool, tare: bool = False, tdc: Float64 | None = None) -> Snapshot:
        """Return the readings so far, for predictions at a time. Later readings do not change them.

        Args:
            stamp_ns: Time of the predictions [ns].
            same_object: Whether they are for the current object, else for one that was not touched.
            tare: Whether a tare was taken shortly before.
            tdc: (F,) TDC at that time [counts]; where it is not known, the latest one counts.
        """
        return Snapshot(self.tracker.copy(), stamp_ns, same_object=same_object, tare=tare, tdc=tdc)

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
            return read_history(self.path, model, self._hand)
        return None

    def write(self, history: History) -> None:
        """Replace the file.

        Raises:
            FileError: If it cannot be written; the one before is kept.
        """
        replace_files({self.path: _content(history, self._hand)})

    def set_aside(self) -> Path:
        """Rename a file that cannot be used to a name that no file has, and return its new path.

        Raises:
            FileError: If it cannot be renamed.
        """
        kept = free_name(self.path, "unused")
        with system_errors(self.path, "cannot be renamed"):
            self.path.rename(kept)
        return kept


def _content(history: History, hand: str) -> bytes:
    tensors = history.to_tensors()
    tensors |= {"version": np.array([VERSION], np.int64), "hand": _text(hand), "model": _text(history.model.name)}
    channels = history.model.sensor.channels
    if channels != BIOTAC:  # files of the BioTac SP state none
        tensors["sensor"] = _text(f"{channels.sensor} {channels.sha256}")
    sha256 = hashlib.sha256(packed(tensors)[0]).digest()
    return packed({**tensors, "sha256": np.frombuffer(sha256, np.uint8)})[0]


def read_history(path: Path, model: TouchModel, hand: str | None = None) -> History:
    """Read the history in a hand's file.

    Args:
        path: The file.
        model: Whose predictions the readings were compared with.
        hand: Name of the hand; None accepts any.

    Raises:
        FileError: If the file is absent or damaged, or of another version, sensor, hand or model.
        ModelError: If the model has no calibration.
    """
    model.new_tracker()  # a model without a calibration is named before the file
    try:
        tensors = load(read_bytes(path, _LARGEST))
    except (SafetensorError, ValueError, KeyError, TypeError, AttributeError) as err:
        raise FileError(path, f"damaged: {' '.join(str(err).split())}") from err
    digest = tensors.pop("sha256", None)
    if digest is None or bytes(digest) != hashlib.sha256(packed(tensors)[0]).digest():
        raise FileError(path, "damaged: its content has another hash")
    version = tensors.get("version", np.array([-1]))
    if version.shape != (1,) or version.dtype.kind not in "iu" or int(version[0]) != VERSION:
        raise FileError(path, f"version: {version.tolist()} is not [{VERSION}]")
    try:
        name, _, sha256 = _read_text(tensors, "sensor").partition(" ")
        sensor = Channels(name, sha256, (), ()) if name else BIOTAC
        require_same(sensor, model.sensor.channels, "sensor")
    except TactileError as err:
        raise FileError(path, str(err)) from err
    for name, own in (("hand", hand), ("model", model.name)):
        stored = _read_text(tensors, name)
        if own is not None and stored != own:
            raise FileError(path, f"{name}: is of {stored!r}, not of {own!r}")
    try:
        return History.from_tensors(model, tensors)
    except ModelError as err:
        raise FileError(path, str(err)) from err


def _text(text: str) -> UInt8:
    return np.frombuffer(text.encode(), np.uint8)


def _read_text(tensors: Mapping[str, AnyArray], name: str) -> str:
    return bytes(tensors.get(name, _text(""))).decode("utf-8", "replace")
