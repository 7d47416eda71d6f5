# SPDX-License-Identifier: Apache-2.0
"""The tare of a stream of readings: what is at rest, and what is not."""

import numpy as np
from pair_builders import PERIOD, REST, T0, interval, stream, true_counts

from foretouch.tactile.contact_detector import LiveTare
from foretouch.tactile.description import packaged_sensor

MS = 1_000_000


def follow(tare, until_ns):
    for reading in stream(1):
        if reading.stamp_ns <= until_ns:
            tare.update(reading.stamp_ns, reading.counts, reading.stamp_ns * 1e-9)


def test_it_is_renewed_after_the_release_and_follows_drift():
    tare = LiveTare()
    follow(tare, T0 + 3000 * MS)
    for k in range(300):
        stamp = T0 + 3000 * MS + k * PERIOD
        tare.update(stamp, true_counts(T0, 1) + np.float32(0.02 * k), stamp * 1e-9)
    found = tare.tare(stamp * 1e-9, 60.0)
    assert tare.age_s(stamp * 1e-9) < 0.5
    np.testing.assert_allclose(found.values - REST, 0.02 * (300 - 30 - 25), atol=0.3)  # the middle of the window


def test_it_ages_is_none_of_a_stream_that_began_in_contact_and_repeated_stamps_fill_no_memory():
    tare = LiveTare()
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
    tare = LiveTare()
    for k in range(30_000):
        tare.update(T0, REST, k * 0.01)
    assert len(tare._recent) == 20_000
    assert {len(finger._recent) for finger in tare._detector.fingers.values()} == {20_000}


def test_channels_that_rest_at_zero_have_no_tare_and_others_are_those_of_the_sensor(rng):
    for name, rest in (("xela_uskin_4x4", 30_000.0), ("tacsl_20x25", 0.01)):
        channels = packaged_sensor(name).channels
        tare = LiveTare(channels)
        for k in range(400):
            noisy = rest + rng.normal(0.0, 0.3, channels.size) * channels.resolution
            tare.update(T0 + k * PERIOD, noisy.astype(np.float32), k * 1e-9 * PERIOD)
        found = tare.tare(400e-9 * PERIOD, 60.0)
        assert found.channels is channels
        np.testing.assert_allclose(found.values, rest * channels.tared, atol=0.5)
