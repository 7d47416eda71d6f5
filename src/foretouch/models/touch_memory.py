# SPDX-License-Identifier: Apache-2.0
"""What was really read on the object at hand, to make later predictions on it better."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from foretouch.errors import TactileError
from foretouch.tactile.validity import check_touch
from foretouch.types import TOUCH_SIZE, Cloud, Float64, Grasp, Touch

if TYPE_CHECKING:
    from foretouch.models.touch_model import TouchModel

__all__ = ["TouchMemory"]


class TouchMemory:
    """Readings on one object in one session, and what one model expected of them.

    What is kept are sums, so that a later prediction costs the same however many readings there were.

    Args:
        model: Whose predictions are compared with the readings.
        tare: A reading without contact, if there is one; predictions with this memory lean on it as well.

    Attributes:
        model: As given.
        tare: As given.
        count: Readings so far.
    """

    def __init__(self, model: TouchModel, tare: Touch | None = None) -> None:
        self.model = model
        self.tare = tare
        self.count = 0
        self._read = np.zeros(TOUCH_SIZE)
        self._expected = np.zeros(TOUCH_SIZE)

    def add(self, cloud: Cloud, grasp: Grasp, reading: Touch) -> None:
        """Take in what was read when a grasp was executed.

        Args:
            cloud: That the grasp was planned on.
            grasp: As executed.
            reading: Both fingers in contact [counts].

        Raises:
            TactileError: If the reading, or the tare, is not that of working sensors.
            CloudError: If the cloud cannot be used.
            ModelError: If the model cannot learn from touches, or refuses the cloud.
        """
        faults = check_touch(reading).faults
        if faults:
            raise TactileError(f"touched: {faults[0]}")
        self._expected += self.model.expect(cloud, [grasp], self.tare)[0]
        self._read += reading.vector()
        self.count += 1

    def means(self) -> tuple[Float64, Float64]:
        """(50,) mean of what was expected and of what was read [counts]; zeros before the first reading."""
        count = max(self.count, 1)
        return self._expected / count, self._read / count
