# SPDX-License-Identifier: Apache-2.0
"""Random numbers by name: each effect of each sample draws from a stream of its own.

So that an effect that is added, or draws more, changes the numbers of no other; and that a sample can be made
again alone, on any worker.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

__all__ = ["SampleKey"]


@dataclass(frozen=True)
class SampleKey:
    """Which sample: with the scene it decides every number.

    Attributes:
        seed: Of the scene.
        slot: Place of the sample in the data set, from 0.
        attempt: How many tries at this place have failed before, from 0.
        repeat: How often the same grasp of the same object was executed before, from 0.
    """

    seed: int
    slot: int
    attempt: int = 0
    repeat: int = 0

    def stream(self, name: str, *, again: bool = False) -> np.random.Generator:
        """The stream of one effect in this sample.

        Args:
            name: Of the effect.
            again: Whether a repeat of the grasp draws other numbers.
        """
        words = (self.seed, *_words(name), self.slot, self.attempt)
        if again and self.repeat:
            words = (*words, self.repeat)
        return np.random.Generator(np.random.PCG64(np.random.SeedSequence(words)))


@lru_cache(maxsize=256)
def _words(name: str) -> tuple[int, ...]:
    digest = hashlib.sha256(name.encode()).digest()
    return tuple(int.from_bytes(digest[i : i + 4], "little") for i in range(0, 16, 4))
