# SPDX-License-Identifier: Apache-2.0
"""Touches of the object at hand. No node, no thread.

Ids of objects hold within one cloud, so the object at hand is told by where it is and how large: the mean and the
deviation of its points, axis by axis. An object in the same frame of which no mean has moved, and no deviation changed, by
more than `same_object_m` since the last touch is taken for the same. Another one that looks the same in the same place
cannot be told apart: whoever changes the object says so (`forget_touches`), or waits for `forget_after_s`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from foretouch.models.touch_memory import TouchMemory
from foretouch.models.touch_model import TouchModel
from foretouch.tactile import offsets, restore
from foretouch.types import Cloud, Float64, Grasp, Touch

__all__ = ["ObjectMemory"]


@dataclass(frozen=True, eq=False)
class _Place:
    """Where an object is, and how large.

    Attributes:
        frame_id: Of the cloud.
        numbers: (6,) float64, mean and deviation of its points in x, y, z [m].
    """

    frame_id: str
    numbers: Float64

    @classmethod
    def of(cls, cloud: Cloud) -> _Place:
        points = cloud.xyz.reshape(-1, 3)
        points = points[np.isfinite(points).all(axis=1)]
        if not len(points):
            return cls(cloud.frame_id, np.full(6, np.inf))  # the same as none
        return cls(cloud.frame_id, np.concatenate([points.mean(axis=0), points.std(axis=0)]).astype(np.float64))

    def is_near(self, other: _Place, distance_m: float) -> bool:
        if self.frame_id != other.frame_id or not np.isfinite([self.numbers, other.numbers]).all():
            return False
        return bool((np.abs(self.numbers - other.numbers) <= distance_m).all())


class ObjectMemory:
    """What was read on one object. Not thread-safe.

    Args:
        model: Whose predictions are compared with the readings.
    """

    def __init__(self, model: TouchModel) -> None:
        self._model = model
        self._memory: TouchMemory | None = None
        self._place: _Place | None = None
        self._touched_s = 0.0

    @property
    def count(self) -> int:
        """Touches in memory."""
        return 0 if self._memory is None else self._memory.count

    def add(
        self, cloud: Cloud, grasp: Grasp, reading: Touch, tare: Touch | None, now_s: float, same_object_m: float
    ) -> None:
        """Take in a touch; if it is of another object than those before, memory begins with it.

        Args:
            cloud: Of the object, that the grasp was planned on.
            grasp: As executed.
            reading: What was read in contact [counts].
            tare: What was read before it; None to compare readings as they are.
            now_s: By a clock that never goes back [s].
            same_object_m: See above [m].

        Raises:
            TactileError: As of `TouchMemory.add`.
            CloudError: Likewise.
            ModelError: Likewise.
        """
        place, memory = _Place.of(cloud), self._memory
        if memory is None or self._place is None or not place.is_near(self._place, same_object_m):
            memory = TouchMemory(self._model, tare)
        elif memory.tare is not None and tare is not None:
            reading = restore(offsets(reading, tare), memory.tare)  # as the sensors read when the first one was taken
        memory.add(cloud, grasp, reading)
        self._memory, self._place, self._touched_s = memory, place, now_s

    def of(self, cloud: Cloud, same_object_m: float) -> TouchMemory | None:
        """What was read on the object in this cloud; None if it is another one or was not touched."""
        if self._memory is None or self._place is None:
            return None
        return self._memory if _Place.of(cloud).is_near(self._place, same_object_m) else None

    def expire(self, now_s: float, after_s: float) -> None:
        """Forget what was last touched so long ago [s]."""
        if self._memory is not None and now_s - self._touched_s > after_s:
            self.forget()

    def forget(self) -> None:
        """Another object is at hand."""
        self._memory = self._place = None
