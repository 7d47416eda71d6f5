# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from foretouch.errors import TactileError
from foretouch.simulation.fingertip import (
    CreepConfig,
    SlipConfig,
    TemperatureConfig,
    creep,
    kill_electrodes,
    slip_path,
    temperature_drift,
    warming,
)

RATE_HZ = 100.0


def test_held_load_creeps_to_its_full_answer():
    config = CreepConfig(share=0.2, time_s=0.5)
    answer = creep(config, np.full(1000, 100.0), RATE_HZ, start=np.array(0.0))
    time = np.arange(1, 1001) / RATE_HZ
    assert_allclose(answer, 100.0 * (1 - 0.2 * np.exp(-time / 0.5)), rtol=1e-9)


def test_skin_at_ease_stays_so():
    assert_allclose(creep(CreepConfig(), np.full((50, 3), 7.0), RATE_HZ), 7.0, rtol=1e-12)


def test_a_cycle_of_load_encloses_an_area():
    load = np.sin(np.linspace(0, np.pi, 200))
    answer = creep(CreepConfig(share=0.3, time_s=0.5), load, RATE_HZ, start=np.array(0.0))
    up, down = answer[:100], answer[:99:-1]
    assert (up[10:90] < down[10:90]).all()


def test_no_share_is_no_creep():
    series = np.random.default_rng(0).normal(size=(30, 4))
    assert_allclose(creep(CreepConfig(share=0.0), series, RATE_HZ), series, rtol=1e-12)


def test_warming_starts_cold_and_ends_at_body_temperature():
    config = TemperatureConfig()
    assert_allclose(warming(config, np.array([0.0, config.warming_s, 1e9])), [0.0, 3.0 * (1 - np.exp(-1)), 3.0])


def test_drift_is_proportional_to_the_temperature():
    pdc, electrodes = temperature_drift(TemperatureConfig(), np.array([0.0, 2.0]))
    assert_allclose(pdc, [0.0, 16.0])
    assert_allclose(electrodes, [0.0, 24.0])


@pytest.mark.parametrize(("stuck_at", "value"), [("low", 0.0), ("high", 4095.0), ("last", 2.0)])
def test_dead_electrode_is_stuck_and_the_others_live(stuck_at, value):
    series = np.arange(48.0).reshape(2, 24)
    dead = kill_electrodes(series, [2], stuck_at)
    assert_allclose(dead[:, 2], value)
    assert_allclose(np.delete(dead, 2, axis=1), np.delete(series, 2, axis=1))
    assert series[0, 2] == 2.0  # the caller's own is left alone


def test_electrode_that_is_none_cannot_die():
    with pytest.raises(TactileError, match="dead: no electrode 24, there are 24"):
        kill_electrodes(np.zeros(24), [24])
    with pytest.raises(TactileError, match="stuck_at: 'nan' is none of low, high, last"):
        kill_electrodes(np.zeros(24), [1], "nan")


def test_slip_moves_forward_in_jumps_at_its_mean_speed(rng):
    config = SlipConfig(speed_m_s=0.01, stick_m=0.002)
    path = slip_path(config, 200_000, RATE_HZ, rng)
    steps = np.diff(path)
    assert path[0] == 0.0
    assert steps.min() >= 0.0
    assert path[-1] / (200_000 / RATE_HZ) == pytest.approx(0.01, rel=0.05)
    assert np.mean(steps > 0) == pytest.approx(1 - np.exp(-0.05), rel=0.05)
