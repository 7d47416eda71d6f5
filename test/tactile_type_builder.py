# SPDX-License-Identifier: Apache-2.0
"""A made-up type of tactile messages: one file and one line in the table of types."""

from pathlib import Path

import pytest

from foretouch.tactile.messages.table import TACTILE_TYPES

MADE_UP_TYPE = "geometry_msgs/PolygonStamped"

_FILE = """
import numpy as np

from foretouch.tactile.messages.table import TactileReader, TactileReading, stamp_ns

def default_fingers(kind):
    return "thumb", "middle"


def make_reader(config):
    return TactileReader(_read)


def _read(message):
    values = np.array([(p.x, p.y, p.z) for p in message.polygon.points], np.float32).ravel()[:50]
    return TactileReading(stamp_ns(message.header.stamp), values, np.empty(0, np.float32))
"""


def add_tactile_type(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Support `MADE_UP_TYPE`, whose points hold 50 counts and one number more."""
    (folder / "made_up.py").write_text(_FILE)
    monkeypatch.syspath_prepend(folder)
    monkeypatch.setitem(TACTILE_TYPES, MADE_UP_TYPE, "made_up")
