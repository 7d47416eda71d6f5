# SPDX-License-Identifier: Apache-2.0
"""The touch of a grasp against the stream that it was cut from."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from every_case import every_case
from pair_builders import PERIOD, REST, SECOND, interval, level, stream

from foretouch.dataset.labelling.buffers import TouchBuffer
from foretouch.dataset.labelling.cut import Interval, PairingConfig, PairingError, SeriesLabel, cut_touch, label_series
from foretouch.tactile.messages.table import TactileReading
from foretouch.types import APPROACH, HOLD
from foretouch.types import REST as REST_PHASE
from foretouch.types.channels import Channel, Channels
from foretouch_lab.simulation.message_faults import FaultConfig

CONFIG = PairingConfig()


def filled(readings: list[TactileReading]) -> TouchBuffer:
    buffer = TouchBuffer()
    for reading in readings:
        buffer.add(reading)
    return buffer


def test_touch_and_tare_are_those_of_hold_and_rest() -> None:
    cut = cut_touch(filled(stream(1)), interval(0), CONFIG)
    np.testing.assert_allclose(cut.touch.values, level(0), atol=4.0)
    np.testing.assert_allclose(cut.tare.values, REST, atol=4.0)
    assert cut.pairing_error_ns == PERIOD
    assert cut.flags == ()
    # First touch begins 0.2 s before the hold; a ramp needs a few readings to stand out of the noise.
    assert cut.contact_ns == pytest.approx(interval(0).contact - 0.2 * SECOND, abs=8 * PERIOD)
    spans = [
        np.ptp(cut.series.stamps_ns[cut.series.phases == phase]) + PERIOD for phase in (REST_PHASE, APPROACH, HOLD)
    ]
    assert spans == [6 * SECOND // 10, SECOND // 2, 7 * SECOND // 10]


def test_what_cannot_be_cut_is_refused_with_its_reason() -> None:
    when, tenth = interval(0), SECOND // 10
    one, two = stream(1), stream(2)
    hole = [r for r in one if not when.contact + 2 * tenth < r.stamp_ns < when.contact + 35 * tenth // 10]
    late = [replace(r, received_ns=r.received_ns + SECOND + k % 7 * tenth) for k, r in enumerate(two)]

    def check(reason: str, readings: list[TactileReading], when: Interval) -> None:
        with pytest.raises(PairingError) as info:
            cut_touch(filled(readings), when, CONFIG)
        assert info.value.reason == reason

    cases = [
        ("pairing_error", hole, when),
        ("no_tactile", [r for r in one if not when.contact < r.stamp_ns < when.release], when),
        ("no_tactile", [], when),
        ("no_tare", [r for r in one if r.stamp_ns > when.start], when),
        ("clock_offset", stream(2, FaultConfig(skew_s=-0.4)), interval(1)),
        ("clock_offset", stream(2, FaultConfig(skew_s=0.4)), interval(1)),
        ("late_readings", late, interval(1)),  # of a busy computer, not blamed on the clocks
        ("bad_interval", one, replace(when, release=when.contact)),
        ("bad_interval", one, replace(when, start=0)),
        ("short_hold", one, replace(when, release=when.contact + SECOND // 5)),
    ]
    every_case(cases, check)
    steady = [replace(r, received_ns=r.received_ns + SECOND) for r in two]
    with pytest.raises(PairingError, match=r"by 1\.\d* s: the clocks differ, or a computer is overloaded"):
        cut_touch(filled(steady), interval(1), CONFIG)


def test_a_tare_neither_reaches_into_the_grasp_before_nor_is_taken_while_something_is_touched() -> None:
    buffer, second = filled(stream(2)), interval(1)
    late = cut_touch(buffer, second, CONFIG, not_before_ns=second.start - 4 * SECOND // 10)
    assert int((late.series.phases == REST_PHASE).sum()) == 30  # 0.4 s less the guard after the release before
    with pytest.raises(PairingError, match=r"readings in 0\.050 s of rest"):
        cut_touch(buffer, second, CONFIG, not_before_ns=second.start - SECOND // 4)
    first = interval(0)
    touched = Interval(start=first.contact + SECOND // 20, contact=first.contact + SECOND // 5, release=first.release)
    with pytest.raises(PairingError, match="touched before") as info:
        cut_touch(buffer, touched, CONFIG)
    assert info.value.reason == "restless_tare"


def test_absent_and_frozen_sensors_are_refused_idle_and_repeating_ones_flagged() -> None:
    readings = stream(1)
    absent = REST.copy()
    absent[2:26] = 0
    dead = filled([replace(r, counts=np.where(absent == 0, 0, r.counts)) for r in readings])
    with pytest.raises(PairingError, match="e_th: all 24 values are 0") as info:
        cut_touch(dead, interval(0), CONFIG)
    assert info.value.reason == "sensor_fault"
    middle = np.r_[1, 26:50]

    def stuck(reading: TactileReading) -> TactileReading:
        counts = reading.counts.copy()
        counts[middle] = REST[middle]
        return replace(reading, counts=counts)

    with pytest.raises(PairingError, match=r"MF: the same .* through rest and contact"):
        cut_touch(filled([stuck(r) for r in readings]), interval(0), CONFIG)
    when = interval(0)
    readings = [replace(r, counts=level(0)) if when.contact <= r.stamp_ns < when.release else r for r in stream(1)]
    assert cut_touch(filled(readings), when, CONFIG).flags == ("frozen_TH", "frozen_MF")
    thumb = np.r_[0, 2:26]
    rng = np.random.default_rng(1)

    def idle(reading: TactileReading) -> TactileReading:
        counts = reading.counts.copy()
        counts[thumb] = np.round(REST[thumb] + rng.normal(0, 1, 25) * np.r_[0.3, np.full(24, 4.4)])
        return replace(reading, counts=counts)

    assert cut_touch(filled([idle(r) for r in stream(1)]), when, CONFIG).flags == ("no_contact_TH",)
    cut = cut_touch(filled([r for r in stream(1) for _ in range(2)]), when, CONFIG)  # each stamp twice
    assert cut.flags == ("duplicate_stamps",)
    assert len(cut.series.counts) == 2 * len(cut_touch(filled(stream(1)), when, CONFIG).series.counts)


def test_stamps_of_zero_are_told() -> None:
    readings = [replace(reading, stamp_ns=0) for reading in stream(1)]
    with pytest.raises(PairingError, match="the stamps of all readings are 0, which their driver does not set"):
        cut_touch(filled(readings), interval(0), CONFIG)


PADS = Channels("pads", "", ("left", "right"), (Channel("P", 4, "counts", 0.0, 4095.0, 1, True, 0.0, 1.0),))
HZ = 50


def labelled(
    course: Callable[[Any], Any], *, right: Callable[[Any], Any] | None = None, count: int = 200
) -> SeriesLabel:
    """The label of a course over time [s] of the taxels of both fingers, of which the first 0.8 s are given as rest."""
    rng, times = np.random.default_rng(0), np.arange(count) / HZ
    both = [course(times), (right or course)(times)]
    counts = np.concatenate([1000.0 + own[:, None] + rng.normal(0.0, 3.0, (count, 4)) for own in both], axis=1)
    return label_series((times * SECOND).astype(np.int64), counts.round(), 40, PADS)


def step(times: Any, begin: float = 1.2, end: float = 9.0, height: float = 200.0) -> Any:
    return height * ((times >= begin) & (times < end))


def test_contact_is_what_lasts_after_the_rest() -> None:
    cases: dict[
        str, tuple[Callable[[Any], Any], float, float]
    ] = {  # its course, when contact begins [s], and the change
        "a contact": (step, 1.2, 200.0),
        "a glitch in the rest": (lambda t: step(t) + step(t, 0.2, 0.26, 3000.0), 1.2, 200.0),
        "lost packets before": (lambda t: step(t) - step(t, 0.9, 0.96, 1000.0), 1.2, 200.0),
        "a slow press": (lambda t: 300.0 * np.clip(t - 1.0, 0.0, 1.0), 1.04, 300.0),
        "a touch that relaxes": (lambda t: step(t) * (1.0 + 0.5 * np.exp(-np.maximum(t - 1.2, 0.0))), 1.2, 220.0),
        "a drift before": (lambda t: 5.0 * np.maximum(t - 0.8, 0.0) + step(t, 2.0, height=300.0), 2.0, 312.0),
    }

    def check(course: Callable[[Any], Any], begin: float, change: float) -> None:
        label = labelled(course)
        assert label.touch is not None
        assert label.contact_ns is not None
        assert abs(label.contact_ns / SECOND - begin) <= 0.06
        np.testing.assert_allclose(label.touch.values, 1000.0 + change, atol=15.0)
        np.testing.assert_allclose(label.tare.values, 1000.0, atol=4.0)
        assert dict(label.flags) == {}

    every_case(cases, check)


def test_what_is_no_steady_contact_is_flagged_or_no_touch() -> None:
    def check(course: Callable[[Any], Any], *flags: str, has_touch: bool) -> None:
        label = labelled(course)
        assert {*label.flags} == {f"{flag}_{finger}" for flag in flags for finger in PADS.fingers}
        assert (label.touch is not None) is has_touch

    check(lambda t: 0.0 * t, "no_contact", has_touch=False)
    check(lambda t: 1.0 * t, "no_contact", has_touch=False)  # within the noise
    check(lambda t: 5.0 * t, "no_contact", "drift", has_touch=False)
    check(lambda t: 100.0 * (1.0 - np.exp(-t)), "no_contact", "drift", has_touch=False)
    check(lambda t: 100.0 * np.maximum(t - 0.8, 0.0), "drift", has_touch=True)
    check(lambda t: step(t, 1.2, 1.4), "no_contact", has_touch=False)  # a tap
    check(lambda t: step(t, 0.7), "contact_in_rest", has_touch=True)
    check(lambda t: step(t, 1.2, 1.8) + step(t, 2.4), "several_contacts", has_touch=True)
    one = labelled(step, right=lambda t: 0.0 * t)
    assert dict(one.flags) == {"no_contact_right": "right is not in contact"}
    assert one.touch is not None


def test_readings_that_are_no_rest_are_refused() -> None:
    with pytest.raises(PairingError, match="something was touched before") as caught:
        labelled(lambda t: step(t, 0.4))
    assert caught.value.reason == "restless_tare"
    with pytest.raises(PairingError, match=r"4 readings of rest before the grasp, fewer than 5") as caught:
        label_series(np.arange(9), np.ones((9, 8)), 4, PADS)
    assert caught.value.reason == "no_tare"


def test_zero_of_a_sensor_without_a_measured_rest_is_not_frozen() -> None:
    force = replace(PADS, channels=(replace(PADS.channels[0], tared=False, noise=0.01, resolution=0.0),))
    counts = np.zeros((100, 8))
    counts[50:, :4] = np.random.default_rng(0).normal(3.0, 0.1, (50, 4))
    label = label_series(np.arange(100) * PERIOD, counts, 40, force)
    assert {*label.flags} == {"no_contact_right"}
