# SPDX-License-Identifier: Apache-2.0
"""Stamps that come twice, in the wrong order, or from a clock that is set."""

from __future__ import annotations

import numpy as np
from pair_builders import NONE, PERIOD, REST, SECOND, T0

from foretouch.dataset.pairing import TouchBuffer, TouchReading


def feed(buffer: TouchBuffer, *stamps: int) -> None:
    for stamp in stamps:
        buffer.add(TouchReading(stamp, REST, NONE, stamp))


def held(buffer: TouchBuffer) -> list[int]:
    return buffer.between(0, 2**62).stamps_ns.tolist()


def test_order_is_that_of_the_stamps_whatever_the_arrival() -> None:
    buffer, stamps = TouchBuffer(), [T0 + k * PERIOD for k in range(200)]
    shuffled = [stamps[k ^ 3] for k in range(200)]
    feed(buffer, *shuffled)
    assert held(buffer) == stamps
    assert buffer.newest_ns == stamps[-1]
    assert dict(buffer.oddities) == {"out_of_order": 150}  # three of each four came late


def test_the_same_stamp_twice_is_kept_and_counted() -> None:
    buffer = TouchBuffer()
    feed(buffer, T0, T0, T0 + PERIOD)
    assert held(buffer) == [T0, T0, T0 + PERIOD]
    assert dict(buffer.oddities) == {"duplicate_stamp": 1}


def test_one_wrong_stamp_is_left_out_in_either_direction() -> None:
    for wrong in (T0 - 3600 * SECOND, T0 + 3600 * SECOND):
        buffer = TouchBuffer()
        feed(buffer, T0, wrong, T0 + PERIOD, T0 + 2 * PERIOD)
        assert held(buffer) == [T0, T0 + PERIOD, T0 + 2 * PERIOD]
        assert dict(buffer.oddities) == {"wrong_stamp": 1}


def test_after_a_clock_was_set_back_nothing_before_it_is_found() -> None:
    buffer, back = TouchBuffer(), T0 - 100 * SECOND
    feed(buffer, *(T0 + k * PERIOD for k in range(50)), *(back + k * PERIOD for k in range(50)))
    assert held(buffer) == [back + k * PERIOD for k in range(50)]
    assert dict(buffer.oddities) == {"clock_jump": 1}


def test_a_pause_keeps_what_was_before() -> None:
    buffer, later = TouchBuffer(), T0 + 10 * SECOND
    feed(buffer, T0, T0 + PERIOD, later, later + PERIOD)
    assert held(buffer) == [T0, T0 + PERIOD, later, later + PERIOD]
    assert dict(buffer.oddities) == {"stamp_gap": 1}


def test_memory_is_bounded_in_time_and_in_number() -> None:
    buffer = TouchBuffer(kept_s=5.0)
    feed(buffer, *(T0 + k * PERIOD for k in range(2000)))
    assert 500 <= len(buffer) <= 600
    crowded = TouchBuffer(kept_s=1e6, most=300)
    feed(crowded, *(T0 + k for k in range(2000)))
    assert len(crowded) == 300
    assert held(crowded)[-1] == T0 + 1999
    assert np.all(np.diff(held(crowded)) == 1)
