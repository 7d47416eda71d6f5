# SPDX-License-Identifier: Apache-2.0
"""Dead, absent and frozen sensors are told finger by finger."""

import numpy as np
from pair_builders import REST

from foretouch.dataset.labelling.sensors import SensorHealth
from foretouch.tactile.description import packaged_sensor

MIDDLE = np.r_[1, 26:50]


def noisy(rng: np.random.Generator) -> np.ndarray:
    return np.round(REST + rng.normal(0, 1, 50) * np.r_[0.5, 0.5, np.full(48, 4.4)]).astype(np.float32)


def test_working_sensors_are_alive_and_silence_faults_frozen_streams_and_a_dead_pdc_are_named() -> None:
    health, rng = SensorHealth(), np.random.default_rng(0)
    assert set(health.states.values()) == {"no data"}
    for _ in range(4000):
        health.update(noisy(rng))
        assert set(health.states.values()) == {"alive"}
    health.silence()
    assert health.states == {"TH": "no data", "MF": "no data"}
    counts = noisy(rng)
    counts[26:] = 0
    health.update(counts)
    assert health.states == {"TH": "alive", "MF": "e_mf: all 24 values are 0, an absent sensor"}
    counts = noisy(rng)
    counts[0] = -22072
    health.update(counts)
    assert health.states["TH"].startswith("pdc_th: -22072 is not between 1 and 4095")
    assert health.states["MF"] == "alive"
    health, rng = SensorHealth(), np.random.default_rng(0)
    for _ in range(201):
        counts = noisy(rng)
        counts[MIDDLE] = REST[MIDDLE]
        health.update(counts)
    assert health.states == {"TH": "alive", "MF": "frozen: the same 201 times, or simulated without noise"}
    for _ in range(3001):
        counts = noisy(rng)
        counts[0] = 2779
        health.update(counts)
    assert health.states["TH"].startswith("dead: PDC constant at 2779 over 300")
    assert health.states["MF"] == "alive"


def test_forces_may_be_zero_for_any_time_but_a_finger_that_is_not_read_is_named() -> None:
    channels = packaged_sensor("tacsl_20x25").channels
    health, rng = SensorHealth(channels), np.random.default_rng(0)
    counts = np.zeros(channels.size, np.float32)
    for _ in range(300):
        counts[channels.finger_columns["right"]] = np.float32(rng.normal(0.0, 0.01))
        health.update(counts)
    assert health.states == {"left": "alive", "right": "alive"}
    for _ in range(300):
        health.update(counts)
    assert health.states["left"] == "alive"
    assert health.states["right"].startswith("frozen: the same 30")
    counts[channels.finger_columns["left"]] = np.nan
    health.update(counts)
    assert health.states["left"] == "normal_left: was not read"
