# SPDX-License-Identifier: Apache-2.0
"""The tare of a stream of readings: what is at rest, and what is not."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from pair_builders import PERIOD, REST, T0, interval, stream, true_counts

from foretouch.ros.touch.live_tare import LiveTare
from foretouch.tactile.contact_detector import ContactConfig

MS = 1_000_000


def follow(tare: LiveTare, until_ns: int, grasps: int = 1) -> None:
    for reading in stream(grasps):
        if reading.stamp_ns <= until_ns:
            tare.update(reading.stamp_ns, reading.counts, reading.stamp_ns * 1e-9)


def test_rest_makes_a_tare_and_contact_keeps_the_one_before() -> None:
    tare = LiveTare(ContactConfig())
    hold = interval(0)
    follow(tare, hold.release - 100 * MS)
    found = tare.tare((hold.release - 100 * MS) * 1e-9, 60.0)
    assert found is not None
    np.testing.assert_allclose(found.vector(), REST, atol=4.0)
    age_s = tare.age_s((hold.release - 100 * MS) * 1e-9)
    assert 0.8 < age_s < 1.6  # from before the fingers closed in


def test_it_is_renewed_after_the_release_and_follows_drift() -> None:
    tare = LiveTare(ContactConfig())
    follow(tare, T0 + 3000 * MS)
    for k in range(300):
        stamp = T0 + 3000 * MS + k * PERIOD
        tare.update(stamp, true_counts(T0, 1) + np.float32(0.02 * k), stamp * 1e-9)
    found = tare.tare(stamp * 1e-9, 60.0)
    assert tare.age_s(stamp * 1e-9) < 0.5
    assert found is not None
    np.testing.assert_allclose(found.vector() - REST, 0.02 * (300 - 30 - 25), atol=0.3)  # the middle of the window


def test_it_ages_and_a_stream_that_began_in_contact_gives_none() -> None:
    tare = LiveTare(ContactConfig())
    assert tare.tare(0.0, 60.0) is None
    hold = interval(0)
    for reading in stream(1):
        if hold.contact <= reading.stamp_ns < hold.release + 200 * MS:
            tare.update(reading.stamp_ns, reading.counts, reading.stamp_ns * 1e-9)
    for k in range(60):  # still held, as far as this stream tells
        stamp = hold.release + 200 * MS + k * PERIOD
        tare.update(stamp, true_counts(hold.contact, 1), stamp * 1e-9)
    tare.exclude(hold.contact, stamp)
    assert tare.tare(stamp * 1e-9, 60.0) is None


def test_a_grasp_told_of_leaves_the_rest_before_it_alone() -> None:
    tare = LiveTare(ContactConfig())
    hold = interval(0)
    follow(tare, hold.release)
    tare.exclude(hold.contact, hold.release)
    assert tare.tare(hold.release * 1e-9, 60.0) is not None
    assert tare.tare(hold.release * 1e-9, 0.1) is None
    assert tare.tare(hold.release * 1e-9 + 100.0, 60.0) is None


def test_a_dead_finger_makes_no_tare_and_is_named() -> None:
    tare = LiveTare(ContactConfig())
    counts = REST.copy()
    counts[0] = -22072.0
    for k in range(200):
        tare.update(T0 + k * PERIOD, counts, k * 0.01)
    assert tare.tare(2.0, 60.0) is None
    assert "pdc_th: -22072" in tare.fault


def test_stamps_that_repeat_do_not_fill_the_memory() -> None:
    tare = LiveTare(ContactConfig(window_s=0.05, lag_s=0.0))
    for k in range(30_000):
        tare.update(T0, REST, k * 0.01)
    assert len(tare._recent) == 20_000
    assert {len(finger._recent) for finger in tare._detector.fingers.values()} == {20_000}
