# SPDX-License-Identifier: Apache-2.0
"""Which colour frame belongs to a depth frame: on stamps written by hand (30 Hz: a period is 33.3 ms)."""

from __future__ import annotations

import pytest

from foretouch.camera.stream import ColourBuffer


def _buffer(*stamps_ms: float) -> ColourBuffer[float]:
    buffer: ColourBuffer[float] = ColourBuffer(33.3, float)
    for stamp in stamps_ms:
        buffer.add(stamp)
    return buffer


@pytest.mark.parametrize(
    ("stamps", "wanted", "found"),
    [
        ([0.0, 33.0, 66.0], 33.0, 33.0),
        ([10.0, 43.0], 33.0, 43.0),  # half a period off is the same moment
        ([0.0, 33.0], 66.0, None),  # a period off is another
        ([90.0], 66.0, None),
        ([], 0.0, None),
    ],
)
def test_the_nearest_within_six_tenths_of_a_period(stamps: list[float], wanted: float, found: float | None) -> None:
    assert _buffer(*stamps).nearest(wanted) == found


def test_what_is_too_old_is_forgotten_and_what_is_later_kept() -> None:
    buffer = _buffer(0.0, 33.0, 66.0)
    assert buffer.nearest(66.0) == 66.0
    assert buffer.nearest(33.0) is None
    assert buffer.nearest(66.0) == 66.0


def test_waiting_is_vain_once_a_later_frame_is_here() -> None:
    buffer = _buffer(0.0)
    assert not buffer.is_past(0.0)
    assert not buffer.is_past(33.0)
    buffer.add(66.0)
    assert buffer.is_past(33.0)
    assert not _buffer().is_past(0.0)
