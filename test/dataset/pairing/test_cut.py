# SPDX-License-Identifier: Apache-2.0
"""The touch of a grasp against the stream that it was cut from."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from every_case import every_case
from pair_builders import PERIOD, REST, SECOND, interval, level, stream

from foretouch.dataset.pairing import Interval, PairingConfig, PairingError, TouchBuffer, TouchReading, cut_touch
from foretouch.dataset.recording import APPROACH, HOLD
from foretouch.dataset.recording import REST as REST_PHASE
from foretouch.simulation.message_faults import FaultConfig

CONFIG = PairingConfig()


def filled(readings: list[TouchReading]) -> TouchBuffer:
    buffer = TouchBuffer()
    for reading in readings:
        buffer.add(reading)
    return buffer


def reason(readings: list[TouchReading], when: Interval | None = None, **options: object) -> str:
    with pytest.raises(PairingError) as info:
        cut_touch(filled(readings), when or interval(0), CONFIG, **options)  # type: ignore[arg-type]
    return info.value.reason


def test_touch_and_tare_are_those_of_hold_and_rest() -> None:
    cut = cut_touch(filled(stream(1)), interval(0), CONFIG)
    np.testing.assert_allclose(cut.touch.vector(), level(0), atol=4.0)
    np.testing.assert_allclose(cut.tare.vector(), REST, atol=4.0)
    assert cut.error_ns == PERIOD
    assert cut.flags == ()
    # First touch begins 0.2 s before the hold; a ramp needs a few readings to stand out of the noise.
    assert cut.contact_ns == pytest.approx(interval(0).contact - 0.2 * SECOND, abs=8 * PERIOD)
    spans = [np.ptp(cut.window.stamps_ns[cut.phases == phase]) + PERIOD for phase in (REST_PHASE, APPROACH, HOLD)]
    assert spans == [6 * SECOND // 10, SECOND // 2, 7 * SECOND // 10]


def test_jitter_skew_and_drops_within_the_tolerance_change_nothing() -> None:
    every_case(range(5), _check_touches)


def _check_touches(seed: int) -> None:
    faults = FaultConfig(jitter_s=0.02, skew_s=0.05, drop_share=0.05)
    buffer = filled(stream(6, faults, seed))
    assert buffer.anomalies["out_of_order"] > 100
    for number in range(6):
        cut = cut_touch(buffer, interval(number), CONFIG)
        # The levels of two grasps are 10 counts apart in 48 electrodes, 20 in PDC.
        np.testing.assert_allclose(cut.touch.vector(), level(number), atol=4.5)
        np.testing.assert_allclose(cut.tare.vector(), REST, atol=4.5)
        assert PERIOD <= cut.error_ns <= CONFIG.tolerance_s * SECOND


def test_holes_beyond_the_tolerance_are_counted_out() -> None:
    when = interval(0)
    hole = [
        r for r in stream(1) if not when.contact + 2 * SECOND // 10 < r.stamp_ns < when.contact + 35 * SECOND // 100
    ]
    assert reason(hole) == "pairing_error"
    assert reason([r for r in stream(1) if not when.contact < r.stamp_ns < when.release]) == "no_tactile"
    assert reason([r for r in stream(1) if r.stamp_ns > when.start]) == "no_tare"
    assert reason([]) == "no_tactile"


def test_a_clock_that_is_off_is_noticed_from_the_time_of_reception() -> None:
    for skew in (-0.4, 0.4):
        assert reason(stream(2, FaultConfig(skew_s=skew)), interval(1)) == "clock_offset"


def test_readings_that_a_busy_computer_receives_late_are_not_blamed_on_the_clocks() -> None:
    readings = stream(2)
    late = [replace(r, received_ns=r.received_ns + SECOND + k % 7 * SECOND // 10) for k, r in enumerate(readings)]
    assert reason(late, interval(1)) == "late_readings"
    steady = [replace(r, received_ns=r.received_ns + SECOND) for r in readings]
    with pytest.raises(PairingError, match=r"by 1\.\d* s: the clocks differ, or a computer is overloaded"):
        cut_touch(filled(steady), interval(1), CONFIG)


def test_a_tare_neither_reaches_into_the_grasp_before_nor_is_taken_while_something_is_touched() -> None:
    buffer, second = filled(stream(2)), interval(1)
    late = cut_touch(buffer, second, CONFIG, not_before_ns=second.start - 4 * SECOND // 10)
    assert int((late.phases == REST_PHASE).sum()) == 30  # 0.4 s less the guard after the release before
    with pytest.raises(PairingError, match=r"readings in 0\.050 s of rest"):
        cut_touch(buffer, second, CONFIG, not_before_ns=second.start - SECOND // 4)
    first = interval(0)
    touched = Interval(start=first.contact + SECOND // 20, contact=first.contact + SECOND // 5, release=first.release)
    with pytest.raises(PairingError, match="touched before") as info:
        cut_touch(buffer, touched, CONFIG)
    assert info.value.reason == "restless_tare"


def test_intervals_that_cannot_be() -> None:
    when = interval(0)
    assert reason(stream(1), replace(when, release=when.contact)) == "bad_interval"
    assert reason(stream(1), replace(when, start=0)) == "bad_interval"
    assert reason(stream(1), replace(when, release=when.contact + SECOND // 5)) == "short_hold"


def test_sensors_that_are_absent_or_frozen_are_refused_by_name() -> None:
    readings = stream(1)
    absent = REST.copy()
    absent[2:26] = 0
    with pytest.raises(PairingError, match="e_th: all 24 electrodes are 0") as info:
        cut_touch(
            filled([replace(r, counts=np.where(absent == 0, 0, r.counts)) for r in readings]), interval(0), CONFIG
        )
    assert info.value.reason == "sensor_fault"
    middle = np.r_[1, 26:50]

    def stuck(reading: TouchReading) -> TouchReading:
        counts = reading.counts.copy()
        counts[middle] = REST[middle]
        return replace(reading, counts=counts)

    with pytest.raises(PairingError, match=r"MF: the same .* through rest and contact"):
        cut_touch(filled([stuck(r) for r in readings]), interval(0), CONFIG)


def test_a_stream_that_freezes_for_a_while_and_a_finger_that_feels_nothing_are_flagged() -> None:
    when = interval(0)
    readings = [replace(r, counts=level(0)) if when.contact <= r.stamp_ns < when.release else r for r in stream(1)]
    assert cut_touch(filled(readings), when, CONFIG).flags == ("frozen_TH", "frozen_MF")
    thumb = np.r_[0, 2:26]
    rng = np.random.default_rng(1)

    def idle(reading: TouchReading) -> TouchReading:
        counts = reading.counts.copy()
        counts[thumb] = np.round(REST[thumb] + rng.normal(0, 1, 25) * np.r_[0.3, np.full(24, 4.4)])
        return replace(reading, counts=counts)

    assert cut_touch(filled([idle(r) for r in stream(1)]), when, CONFIG).flags == ("no_contact_TH",)


def test_every_reading_is_kept_where_stamps_come_twice() -> None:
    readings = stream(1)
    twice = [r for r in readings for _ in range(2)]
    cut = cut_touch(filled(twice), interval(0), CONFIG)
    assert cut.flags == ("duplicate_stamps",)
    assert len(cut.window) == 2 * len(cut_touch(filled(readings), interval(0), CONFIG).window)
