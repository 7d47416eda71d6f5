# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest
from numpy.testing import assert_allclose

from benchmarks.simulation.validate import steady_noise
from foretouch_lab.simulation.fingertip import (
    NOISE_ELECTRODE,
    WANDER_COUNTS,
    WANDER_S,
    creep,
    ou_noise,
    scan,
    slip_path,
    temperature_drift,
    warming,
)

RATE_HZ = 100.0


def steady_touch(seed, rows=280):
    """A steady touch with all the noise on, in whole counts."""
    rng = np.random.default_rng(seed)
    counts = 3400.0 + NOISE_ELECTRODE * rng.standard_normal((rows, 24))
    counts += ou_noise(rows, 24, WANDER_COUNTS, WANDER_S, RATE_HZ, rng)
    return np.rint(scan(counts, rng))


def repeats(series):
    """Shares of values that repeat together with their neighbour in the ring, and again a row later."""
    same = [np.diff(one, axis=0) == 0 for one in series]
    side = np.mean([np.mean(one & np.roll(one, 1, axis=1)) for one in same])
    return side, np.mean([np.mean(one[1:] & one[:-1]) for one in same])


@pytest.mark.real_data
def test_recorded_noise_is_what_the_simulation_aims_at(real_data):
    files = sorted((real_data / "biotac_steady_100hz").glob("*.csv"))
    assert len(files) == 22
    series = [np.loadtxt(file, delimiter=",", skiprows=1) for file in files]
    made = [steady_touch(seed) for seed in range(22)]
    recorded, simulated = steady_noise(series), steady_noise(made)
    assert simulated.sd == pytest.approx(recorded.sd, abs=0.2)
    assert simulated.repeated == pytest.approx(recorded.repeated, abs=0.02)
    assert simulated.lag1 == pytest.approx(recorded.lag1, abs=0.06)
    assert_allclose(repeats(made), repeats(series), atol=0.03)  # in blocks that move on


def test_fluctuation_has_its_deviation_and_memory_and_slip_moves_in_jumps_at_its_mean_speed(rng):
    x = ou_noise(20000, 4, 3.0, 0.05, RATE_HZ, rng)
    assert x.std() == pytest.approx(3.0, rel=0.1)
    assert np.mean(x[5:] * x[:-5]) / x.var() == pytest.approx(np.exp(-1.0), abs=0.05)
    path = slip_path(200_000, RATE_HZ, rng)
    steps = np.diff(path)
    assert path[0] == 0.0
    assert steps.min() >= 0.0
    assert path[-1] / (200_000 / RATE_HZ) == pytest.approx(0.005, rel=0.05)
    assert np.mean(steps > 0) == pytest.approx(1 - np.exp(-0.1), rel=0.05)
    assert len(slip_path(0, RATE_HZ, rng)) == 0


def test_scan_repeats_what_the_ring_has_not_sampled_since_the_last_message(rng):
    rows = np.broadcast_to(np.arange(5000.0)[:, None], (5000, 24))
    sampled = scan(rows, rng)  # when each value was sampled
    assert (sampled <= rows).all()
    fresh = sampled[1:] == rows[1:]
    assert (sampled[1:][~fresh] == sampled[:-1][~fresh]).all()
    assert fresh.sum(axis=1).mean() == pytest.approx(16.8, rel=0.01)
    edges = (fresh != np.roll(fresh, 1, axis=1)).sum(axis=1)
    assert set(edges.tolist()) <= {0, 2}  # one block of the ring a message


def test_creep_comes_late_with_hysteresis_and_drift_ends_at_body_temperature():
    step = np.append(0.0, np.full(1000, 100.0))
    time = np.arange(1, 1001) / RATE_HZ
    assert_allclose(creep(step, RATE_HZ, share=0.2, time_s=0.5)[1:], 100.0 * (1 - 0.2 * np.exp(-time / 0.5)))
    load = np.sin(np.linspace(0, np.pi, 200))
    response = creep(load, RATE_HZ, share=0.3, time_s=0.5)
    assert (response[10:90] < response[189:109:-1]).all()
    assert_allclose(creep(load, RATE_HZ, share=0.0), load, rtol=1e-12)
    drift = temperature_drift(warming(np.array([0.0, 600.0, 1e9])))
    kelvin = np.array([0.0, 3.0 * (1 - np.exp(-1)), 3.0])
    assert_allclose(drift, np.outer(kelvin, [8.0] + [12.0] * 24))
