# SPDX-License-Identifier: Apache-2.0
"""A made-up type of tactile messages: a decoder and its lines in the tables."""

from typing import Any

import numpy as np
import pytest

from foretouch.tactile.messages.readers import READERS
from foretouch.tactile.messages.table import TACTILE_TYPES, TactileReader, TactileReading
from foretouch.types import stamp_ns

MADE_UP_TYPE = "geometry_msgs/PolygonStamped"


def _read(message: Any) -> TactileReading:
    values = np.array([(p.x, p.y, p.z) for p in message.polygon.points], np.float32).ravel()[:50]
    return TactileReading(stamp_ns(message.header.stamp), values, np.empty(0, np.float32))


def add_tactile_type(monkeypatch: pytest.MonkeyPatch) -> None:
    """Support `MADE_UP_TYPE`, whose points hold 50 counts and one number more."""
    monkeypatch.setitem(TACTILE_TYPES, MADE_UP_TYPE, ("thumb", "middle"))
    monkeypatch.setitem(READERS, MADE_UP_TYPE, lambda _: TactileReader(_read))
