# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from foretouch.errors import TactileError
from foretouch.simulation.fingertip import (
    NoiseConfig,
    ScanConfig,
    fresh_samples,
    hold,
    steady_noise,
    wander,
    white_noise,
)

RATE_HZ = 100.0


def steady_touch(seed, rows=280):
    """A steady touch with all the noise on, in whole counts."""
    rng = np.random.default_rng(seed)
    noise = NoiseConfig()
    counts = 3400.0 + white_noise((rows, 24), noise.electrode_counts, rng)
    counts += wander(rows, 24, noise.wander_counts, noise.wander_s, RATE_HZ, rng)
    return np.rint(hold(counts, fresh_samples(ScanConfig(), rows, 24, rng)))


def assert_like_the_sensor(noise):
    assert noise.sd == pytest.approx(4.4, abs=0.5)
    assert noise.repeated == pytest.approx(0.35, abs=0.05)
    assert noise.lag1 == pytest.approx(0.38, abs=0.08)


def test_simulated_noise_is_the_sensors():
    assert_like_the_sensor(steady_noise([steady_touch(seed) for seed in range(22)]))


@pytest.mark.real_data
def test_recorded_noise_is_what_the_simulation_aims_at(real_data):
    files = sorted((real_data / "biotac_steady_100hz").glob("*.csv"))
    assert len(files) == 22
    recorded = steady_noise([np.loadtxt(file, delimiter=",", skiprows=1) for file in files])
    assert_like_the_sensor(recorded)
    simulated = steady_noise([steady_touch(seed) for seed in range(22)])
    assert simulated.sd == pytest.approx(recorded.sd, abs=0.2)
    assert simulated.repeated == pytest.approx(recorded.repeated, abs=0.02)
    assert simulated.lag1 == pytest.approx(recorded.lag1, abs=0.06)


@pytest.mark.real_data
def test_recorded_repeats_move_on_in_blocks_as_simulated(real_data):
    """Neighbours in the ring repeat together; a row later the block has moved on."""

    def neighbours(series):
        repeats = [np.diff(s, axis=0) == 0 for s in series]
        side = np.mean([np.mean(r & np.roll(r, 1, axis=1)) for r in repeats])
        after = np.mean([np.mean(r[1:] & r[:-1]) for r in repeats])
        return side, after

    files = sorted((real_data / "biotac_steady_100hz").glob("*.csv"))
    recorded = neighbours([np.loadtxt(file, delimiter=",", skiprows=1) for file in files])
    simulated = neighbours([steady_touch(seed) for seed in range(22)])
    assert_allclose(simulated, recorded, atol=0.03)


def test_estimator_finds_white_noise(rng):
    noise = steady_noise([np.rint(rng.normal(3000.0, 5.0, (4000, 24)))])
    assert noise.sd == pytest.approx(5.0, rel=0.05)
    assert noise.repeated == pytest.approx(0.056, abs=0.01)  # 1 / (2 σ √π), steps that round to 0
    assert noise.lag1 == pytest.approx(0.0, abs=0.02)


def test_estimator_leaves_a_slope_aside(rng):
    counts = rng.normal(3000.0, 5.0, (400, 24))
    plain = steady_noise([counts])
    sloped = steady_noise([counts + 8.0 * np.arange(400)[:, None] / RATE_HZ])
    assert sloped.sd == pytest.approx(plain.sd, rel=1e-3)
    assert sloped.lag1 == pytest.approx(plain.lag1, abs=1e-9)


@pytest.mark.parametrize(
    ("series", "message"),
    [
        ([], "nothing moves"),
        ([np.ones((20, 3))], "nothing moves"),
        ([np.ones((5, 3))], r"series\[0\]: shape \(5, 3\) is not \(T, C\) with T at least 10"),
    ],
)
def test_estimator_refuses_what_it_cannot_judge(series, message):
    with pytest.raises(TactileError, match=message):
        steady_noise(series)


def test_wander_has_its_deviation_and_memory(rng):
    x = wander(20000, 4, 3.0, 0.05, RATE_HZ, rng)
    assert x.std() == pytest.approx(3.0, rel=0.1)
    assert np.mean(x[5:] * x[:-5]) / x.var() == pytest.approx(np.exp(-1.0), abs=0.05)


def test_scan_refreshes_the_ring_in_turn():
    exact = ScanConfig(fresh_per_row=8.0, jitter=0.0)
    fresh = fresh_samples(exact, 31, 24, np.random.default_rng(3))
    assert fresh[0].all()
    assert (fresh[1:].sum(axis=1) == 8).all()
    assert (sum(fresh[k] for k in (1, 2, 3)) == 1).all()  # three rows make one round


def test_scan_refreshes_as_often_as_told():
    fresh = fresh_samples(ScanConfig(), 5000, 24, np.random.default_rng(0))
    assert fresh[1:].sum(axis=1).mean() == pytest.approx(ScanConfig().fresh_per_row, rel=0.01)


def test_hold_repeats_the_last_fresh_value():
    series = np.array([[1.0, 10.0], [2.0, 20.0], [3.0, 30.0]])
    fresh = np.array([[True, True], [False, True], [True, False]])
    assert_allclose(hold(series, fresh), [[1, 10], [1, 20], [3, 20]])


def test_hold_needs_a_first_value():
    with pytest.raises(TactileError, match="1 channels have no first value"):
        hold(np.zeros((2, 2)), np.array([[True, False], [True, True]]))
    with pytest.raises(TactileError, match=r"shape \(1, 2\) is not that of the series, \(2, 2\)"):
        hold(np.zeros((2, 2)), np.ones((1, 2), bool))
