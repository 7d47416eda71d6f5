# SPDX-License-Identifier: Apache-2.0
"""Offsets from a tare: a reading without contact.

The BioTac SP is not temperature-compensated and drifts with temperature, inflation and wear, so counts
compare only against the same finger at rest, a short while before.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from foretouch.errors import TactileError
from foretouch.tactile.validity import check_touch
from foretouch.types import Float64, Touch

__all__ = ["make_tare", "offsets", "restore"]


def make_tare(readings: Sequence[Touch]) -> Touch:
    """The median of readings without contact, which one disturbed sample does not move.

    Args:
        readings: At least one.

    Raises:
        TactileError: If there is none, or one is no reading of a working sensor.
    """
    if not readings:
        raise TactileError("tare: no reading")
    for i, reading in enumerate(readings):
        faults = check_touch(reading).faults
        if faults:
            raise TactileError(f"tare: reading {i}: {faults[0]}")
    return Touch.from_vector(np.median([reading.vector() for reading in readings], axis=0))


def offsets(touch: Touch, tare: Touch) -> Float64:
    """(50,) float64 [counts], touch minus tare: PDC rises and electrodes fall with pressure."""
    return touch.vector() - tare.vector()


def restore(offset: Float64, tare: Touch) -> Touch:
    """The inverse of `offsets`."""
    return Touch.from_vector(offset + tare.vector())
