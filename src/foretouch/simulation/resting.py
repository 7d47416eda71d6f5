# SPDX-License-Identifier: Apache-2.0
"""Fingertips at rest, one message after the other, for as long as anybody listens."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from foretouch.simulation.execution import SimulatedHand

__all__ = ["RestingFingers"]

_BLOCK = 200  # messages that are made at a time
_STREAMS = 1 << 20  # apart from the numbers by which grasps are repeated


class RestingFingers:
    """Readings without contact, each new.

    Args:
        hand: Whose fingers; nobody else may use it at the same time.
        stream: Two with another number have noise of their own.
    """

    def __init__(self, hand: SimulatedHand, stream: int = 0) -> None:
        self._hand = hand
        self._repeat = _STREAMS * (stream + 1)
        self._rows: npt.NDArray[np.int16] = np.empty((0, 2, 25), np.int16)
        self._next = 0

    def read(self, elapsed_s: float) -> npt.NDArray[np.int16]:
        """(2, 25) int16 counts: thumb and middle finger, PDC then electrodes.

        Args:
            elapsed_s: Time since the hand was switched on [s].
        """
        if self._next == len(self._rows):
            self._rows, self._next = self._hand.rest(_BLOCK, self._repeat, elapsed_s), 0
            self._repeat += 1
        self._next += 1
        return np.asarray(self._rows[self._next - 1], np.int16)
