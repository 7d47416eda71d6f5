# SPDX-License-Identifier: Apache-2.0
"""Touches of the current object. No node, no thread.

Ids of objects are valid within one cloud only. Therefore the current object is identified by its position and size: the
mean and the standard deviation of its points along each axis. An object in the same frame is the same if no mean and
no deviation has changed by more than `same_object_m` since the last touch. A different object that looks the same at
the same position cannot be distinguished: after changing the object, call `forget_touches` or wait for
`forget_after_s`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from foretouch.models.touch_model import ObjectResiduals, TouchModel
from foretouch.tactile import offsets, restore
from foretouch.types import Cloud, Float64, Grasp, Touch


@dataclass(frozen=True, eq=False)
class _Extent:
    """Position and size of an object.

    Attributes:
        frame_id: Frame of the cloud.
        numbers: (6,) float64, mean and standard deviation of its points in x, y, z [m].
    """

    frame_id: str
    numbers: Float64

    @classmethod
    def of(cls, cloud: Cloud) -> _Extent:
        points = cloud.xyz.reshape(-1, 3)
        points = points[np.isfinite(points).all(axis=1)]
        if not len(points):
            return cls(cloud.frame_id, np.full(6, np.inf))  # equal to no other object
        return cls(cloud.frame_id, np.concatenate([points.mean(axis=0), points.std(axis=0)]).astype(np.float64))

    def is_near(self, other: _Extent, distance_m: float) -> bool:
        if self.frame_id != other.frame_id or not np.isfinite([self.numbers, other.numbers]).all():
            return False
        return bool((np.abs(self.numbers - other.numbers) <= distance_m).all())


class ObjectMemory:
    """The touches of one object. Not thread-safe.

    Args:
        model: Its predictions are compared with the readings.
    """

    def __init__(self, model: TouchModel) -> None:
        self._model = model
        self._memory: ObjectResiduals | None = None
        self._extent: _Extent | None = None
        self._touched_s = 0.0

    @property
    def count(self) -> int:
        """Number of touches."""
        return 0 if self._memory is None else self._memory.count

    def add(
        self, cloud: Cloud, grasp: Grasp, reading: Touch, tare: Touch | None, now_s: float, same_object_m: float
    ) -> None:
        """Add a touch; touches of another object before it are forgotten.

        Args:
            cloud: Cloud of the object that the grasp was planned on.
            grasp: The executed grasp.
            reading: Tactile reading in contact [counts].
            tare: Tactile reading before contact; None to compare readings without a tare.
            now_s: Time of a clock that never goes back [s].
            same_object_m: See above [m].

        Raises:
            TactileError: See `ObjectResiduals.add`.
            CloudError: See `ObjectResiduals.add`.
            ModelError: See `ObjectResiduals.add`.
        """
        extent, memory = _Extent.of(cloud), self._memory
        if memory is None or self._extent is None or not extent.is_near(self._extent, same_object_m):
            memory = ObjectResiduals(self._model, tare)
        elif memory.tare is not None and tare is not None:
            reading = restore(offsets(reading, tare), memory.tare)  # as the sensors read when the first one was taken
        memory.add(cloud, grasp, reading)
        self._memory, self._extent, self._touched_s = memory, extent, now_s

    def of(self, cloud: Cloud, same_object_m: float) -> ObjectResiduals | None:
        """The touches of the object in this cloud; None if it is another object or was not touched."""
        if self._memory is None or self._extent is None:
            return None
        return self._memory if _Extent.of(cloud).is_near(self._extent, same_object_m) else None

    def expire(self, now_s: float, after_s: float) -> None:
        """Forget the touches if the last one is older than this [s]."""
        if self._memory is not None and now_s - self._touched_s > after_s:
            self.forget()

    def forget(self) -> None:
        """Forget all touches."""
        self._memory = self._extent = None
