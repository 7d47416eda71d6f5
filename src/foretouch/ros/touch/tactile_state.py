# SPDX-License-Identifier: Apache-2.0
"""What the online adaptation remembers: tare of the hand, touches of the current object. No node, no thread.

The tare is taken from the readings while the hand touches nothing. A reading is at rest if neither finger is in
contact, by the contact detector, nor will be within `lag_s`: a contact is detected a moment after it has begun. The
tare is the median over the last `window_s` of rest; during a grasp, the tare from before is kept, and ages.

Ids of objects are valid within one cloud only. Therefore the current object is identified by its position and size: the
mean and the standard deviation of its points along each axis. An object in the same frame is the same if no mean and
no deviation has changed by more than `same_object_m` since the last touch. A different object that looks the same at
the same position cannot be distinguished: after changing the object, call `forget_touches` or wait for
`forget_after_s`.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np

from foretouch.cloud.geometry.limits import DEFAULT_LIMITS, ObjectLimits
from foretouch.models.hand_history import Extent, HandHistory
from foretouch.models.touch_model import ObjectResiduals, TouchModel
from foretouch.tactile import check_touch, offsets, restore
from foretouch.tactile.contact_detector import ContactConfig, ContactDetector
from foretouch.types import Cloud, Float32, Grasp, Touch

_SECOND_NS = 1_000_000_000
_MIN_READINGS = 5
_RENEW_EVERY = 10  # readings: the tare hardly changes, and a median takes time
_MAX_READINGS = 20_000  # of the longest window and lag, 120 s, at 100 Hz; stamps that repeat would fill the memory
_MIN_SPAN = 0.8  # of the window


class LiveTare:
    """The tare of a stream of readings. Not thread-safe.

    Args:
        config: Settings of the contact detector; its `window_s` and `lag_s` are used for the tare too.

    Attributes:
        fault: Why the last rest gives no tare, such as a dead sensor; "" without a fault or without a rest.
    """

    def __init__(self, config: ContactConfig) -> None:
        self.fault = ""
        self._detector = ContactDetector(config)
        self._lag_ns = round(config.lag_s * _SECOND_NS)
        self._window_ns = round(config.window_s * _SECOND_NS)
        self._recent: deque[tuple[int, Float32]] = deque(maxlen=_MAX_READINGS)
        self._rest: list[Float32] = []
        self._rest_ns = 0
        self._rest_s = 0.0
        self._tare: Touch | None = None
        self._since_renewal = 0

    def update(self, stamp_ns: int, counts: Float32, now_s: float) -> None:
        """Add a reading that the `TouchBuffer` has accepted: its stamp is not checked again.

        Args:
            stamp_ns: Stamp of the reading [ns].
            counts: (50,) as `Touch.vector()`.
            now_s: Time of a clock that never goes back [s].
        """
        self._detector.update(stamp_ns, counts)
        touching = [finger.touching for finger in self._detector.fingers.values()]
        if any(touching):
            self._recent.clear()  # its end may belong to the contact; the rest before it is kept
            return
        self._recent.append((stamp_ns, counts))
        oldest = stamp_ns - self._lag_ns - self._window_ns
        while self._recent[0][0] < oldest:
            self._recent.popleft()
        self._since_renewal += 1
        if self._since_renewal >= _RENEW_EVERY and None not in touching:
            self._renew(stamp_ns, now_s)

    def tare(self, now_s: float, max_age_s: float) -> Touch | None:
        """The median of the last rest; None if there is no recent one, or a sensor does not work."""
        if self.age_s(now_s) > max_age_s:
            return None
        if self._tare is None and not self.fault:
            touch = Touch.from_vector(np.median(self._rest, axis=0))
            self.fault = "; ".join(check_touch(touch).faults)
            self._tare = None if self.fault else touch
        return self._tare

    def age_s(self, now_s: float) -> float:
        """Time since the last rest [s]; infinite if there was none."""
        return now_s - self._rest_s if self._rest else float("inf")

    def exclude(self, contact_ns: int, release_ns: int) -> None:
        """Reset a tare from within a reported grasp, such as where the stream began in contact.

        Args:
            contact_ns: When contact was steady [ns].
            release_ns: When the hand began to open [ns].
        """
        if self._rest and contact_ns <= self._rest_ns < release_ns:
            self.reset()

    def reset(self) -> None:
        """Restart, after the clock has jumped or a contact was taken for rest."""
        self._detector.reset()
        self._recent.clear()
        self._rest, self._tare, self.fault = [], None, ""

    def _renew(self, stamp_ns: int, now_s: float) -> None:
        newest = stamp_ns - self._lag_ns
        rest = [counts for stamp, counts in self._recent if stamp <= newest]
        spans = newest - self._recent[0][0] >= _MIN_SPAN * self._window_ns
        if len(rest) >= _MIN_READINGS and spans:
            self._rest, self._rest_ns, self._rest_s = rest, newest, now_s - self._lag_ns / _SECOND_NS
            self._tare, self.fault, self._since_renewal = None, "", 0


class ObjectMemory:
    """The touches of one object. Not thread-safe.

    Args:
        model: Its predictions are compared with the readings.
        now_s: Gives the time of a clock that never goes back [s].
    """

    def __init__(self, model: TouchModel, now_s: Callable[[], float] = time.monotonic) -> None:
        self._model = model
        self._now_s = now_s
        self._memory: ObjectResiduals | None = None
        self._extent: Extent | None = None
        self._touched_s = 0.0

    @property
    def count(self) -> int:
        """Number of touches."""
        return 0 if self._memory is None else self._memory.count

    def add(
        self,
        cloud: Cloud,
        grasp: Grasp,
        reading: Touch,
        tare: Touch | None,
        same_object_m: float,
        limits: ObjectLimits = DEFAULT_LIMITS,
    ) -> None:
        """Add a touch; touches of another object before it are forgotten.

        Args:
            cloud: Cloud of the object that the grasp was planned on.
            grasp: The executed grasp.
            reading: Tactile reading in contact [counts].
            tare: Tactile reading before contact; None to compare readings without a tare.
            same_object_m: See above [m].
            limits: Range and size of objects.

        Raises:
            TactileError: See `ObjectResiduals.add`.
            CloudError: See `ObjectResiduals.add`.
            ModelError: See `ObjectResiduals.add`.
        """
        extent, memory = Extent.of(cloud), self._memory
        if memory is None or self._extent is None or not extent.is_near(self._extent, same_object_m):
            memory = ObjectResiduals(self._model, tare)
        elif memory.tare is not None and tare is not None:
            reading = restore(offsets(reading, tare), memory.tare)  # as the sensors read when the first one was taken
        memory.add(cloud, grasp, reading, limits)
        self._memory, self._extent, self._touched_s = memory, extent, self._now_s()

    def basis(self, cloud: Cloud, tare: Touch | None, same_object_m: float) -> dict[str, Any]:
        """What predictions on a cloud adapt to, as arguments of `TouchModel.predict`."""
        residuals = self.of(cloud, same_object_m)
        return {"tare": tare} if residuals is None else {"residuals": residuals}

    def of(self, cloud: Cloud, same_object_m: float) -> ObjectResiduals | None:
        """The touches of the object in this cloud; None if it is another object or was not touched."""
        if self._memory is None or self._extent is None:
            return None
        return self._memory if Extent.of(cloud).is_near(self._extent, same_object_m) else None

    def expire(self, after_s: float) -> None:
        """Forget the touches if the last one is older than this [s]."""
        if self._memory is not None and self._now_s() - self._touched_s > after_s:
            self.forget()

    def forget(self) -> None:
        """Forget all touches."""
        self._memory = self._extent = None

    def forget_history(self) -> int:
        """Forget all touches; gives their number."""
        count = self.count
        self.forget()
        return count


class HandMemory:
    """All readings of a hand, and the current object. Not thread-safe; as `ObjectMemory`, for a model with a tracker.

    Args:
        history: The readings so far.
        now_ns: Gives the time of the node's clock, which stamps the readings [ns].
    """

    def __init__(self, history: HandHistory, now_ns: Callable[[], int]) -> None:
        self.history = history
        self._now_ns = now_ns

    @property
    def count(self) -> int:
        """Number of touches of the current object."""
        return self.history.touches

    def add(
        self,
        cloud: Cloud,
        grasp: Grasp,
        reading: Touch,
        tare: Touch | None,
        same_object_m: float,
        limits: ObjectLimits = DEFAULT_LIMITS,
    ) -> None:
        """As `ObjectMemory.add`; what touches of another object before it say about the sensors is kept."""
        now_ns = self._now_ns()
        if tare is not None:
            self.history.add_tare(now_ns, tare)
        new = not self.history.is_current(cloud, same_object_m)
        self.history.add_touch(now_ns, cloud, grasp, reading, new_object=new, limits=limits)

    def basis(self, cloud: Cloud, tare: Touch | None, same_object_m: float) -> dict[str, Any]:
        """As `ObjectMemory.basis`; adds the tare to the history."""
        now_ns = self._now_ns()
        if tare is not None:
            self.history.add_tare(now_ns, tare)
        same = self.history.is_current(cloud, same_object_m)
        return {"history": self.history.at(now_ns, same_object=same, tare=tare is not None)}

    def expire(self, after_s: float) -> None:
        """Forget the object if its last touch is older than this [s]."""
        age_s = self.history.tracker.evidence(self._now_ns()).touch_age_s
        if age_s is not None and age_s > after_s:
            self.forget()

    def forget(self) -> None:
        """Forget the object, and keep the state of the sensors."""
        self.history.start_object()

    def forget_history(self) -> int:
        """Forget all readings; gives their number."""
        return self.history.forget()
