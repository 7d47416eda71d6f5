# SPDX-License-Identifier: Apache-2.0
"""Counts of simulated rigid grasps spread as those of real ones do (`benchmarks/simulation` shows it on whole grasps)."""

from __future__ import annotations

import numpy as np
import pytest

from foretouch.simulation.contact import (
    Command,
    ContactProblem,
    PadConfig,
    gap_field,
    pad_direction,
    pad_window,
    solve_contact,
)
from foretouch.simulation.contact.pad import bent_surface, wedge
from foretouch.simulation.fingertip import (
    MIDDLE_FINGER,
    THUMB,
    FingertipConfig,
    NoiseConfig,
    draw_finger,
    quantise,
    read_contact,
    white_noise,
)


def contact(rng: np.random.Generator, pad: PadConfig):
    """Anywhere on the pad, on a plane, a cylinder or an edge: window, problem and force of 1 to 5 N."""
    pitch, roll = rng.normal(0.0, 0.3), float(np.clip(rng.normal(0.0, 0.35), -1.2, 1.2))
    force, angle, radius = rng.uniform(1.0, 5.0), rng.uniform(0.0, np.pi), rng.uniform(0.02, 0.05)
    beside, kind = rng.normal(0.0, 0.002), rng.integers(3)
    window = pad_window(pad, pad_direction(pitch, roll))
    heights = (
        lambda x, y: np.zeros_like(x),
        lambda x, y: bent_surface(x, y, 1.0 / radius, 0.0, angle),
        lambda x, y: wedge(x - beside, y, 1.0, angle, 0.002),
    )
    height = heights[kind](window.x, window.y)
    return window, ContactProblem(gap_field(window.depth, height), pad.step_m, (pad.layer,)), force


@pytest.mark.parametrize(
    ("kind", "median", "percentile_99"), [(MIDDLE_FINGER, 72.0, 691.0), (THUMB, 117.0, 986.0)], ids=["MF", "TH"]
)
def test_counts_spread_as_in_real_grasps(kind, median, percentile_99):
    pad, noise, config, seed = PadConfig(), NoiseConfig(), FingertipConfig(), 7
    contacts, rng = np.random.default_rng(seed), np.random.default_rng([seed, 1])
    finger = draw_finger(kind, rng)
    pressures, read = [], []
    for _ in range(200):
        window, problem, force = contact(contacts, pad)
        reading = read_contact(config, pad, finger, window, solve_contact(problem, Command(force_n=force)))
        pressures.append(reading.pdc + noise.pdc_counts * rng.standard_normal())
        read.append(reading.electrodes + white_noise((24,), noise.electrode_counts, rng))
    pdc, electrodes = quantise(config, pressures, read)
    drop = np.percentile(electrodes, 95, axis=0) - electrodes
    variances = np.linalg.eigvalsh(np.cov(electrodes.T.astype(float)))[::-1]
    assert median / 1.5 < np.median(drop) < median * 1.5
    assert percentile_99 / 1.5 < np.percentile(drop, 99) < percentile_99 * 1.5
    assert 0.65 < variances[:4].sum() / variances.sum() < 0.85
    assert abs(np.corrcoef(pdc, electrodes.mean(axis=1))[0, 1]) < 0.4
