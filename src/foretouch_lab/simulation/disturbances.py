# SPDX-License-Identifier: Apache-2.0
"""Disturbances of the counts: noise, a slow scan, creep of the skin, drift with temperature, dead electrodes and slip.

The defaults are fitted to recordings of a BioTac SP in steady touch at 100 Hz. The electrodes are sampled one after the
other in a ring; each message takes what has been sampled since the last one, about 17 of 24, and repeats the rest: a
block of about eight that moves on from row to row.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from foretouch.config import Settings, setting
from foretouch.tactile import ELECTRODES, FULL_SCALE
from foretouch.types import Float64

_FRESH_PER_ROW: Final = 16.8  # electrodes that are sampled between two messages
_CUT_JITTER: Final = 1.0  # standard deviation of where a message cuts the ring [electrodes]

PDC_PER_KELVIN: Final = 8.0  # [counts/K]; orders of magnitude, not measurements: they differ from sensor to sensor
ELECTRODE_PER_KELVIN: Final = 12.0  # [counts/K]

TDC_PER_KELVIN: Final = 75.0  # [counts/K]; slope of the converter's curve between 2350 and 2700, where recordings are
TAC_PER_KELVIN_S: Final = 400.0  # [counts s/K]; an order of magnitude: recorded TAC varies by tens of counts
VIBRATION_S: Final = 0.03  # time in which a vibration of the skin falls to 1/e
PAC_REST: Final = 2048.0  # PAC of a still fingertip
TAC_REST: Final = 2048.0  # TAC at a steady temperature
TDC_REST: Final = (2400.0, 2580.0)  # TDC of thumb and middle finger at power-on [counts], about as recorded

WANDER_COUNTS: Final = 1.9  # standard deviation of the slow fluctuation of an electrode
WANDER_S: Final = 0.4  # time in which its correlation falls to 1/e

CREEP_SHARE: Final = 0.08  # part of the response that comes late
CREEP_TIME_S: Final = 1.5  # time constant of the late part

SLIP_SPEED_M_S: Final = 0.005  # mean speed of the object over the skin
SLIP_LENGTH_M: Final = 0.0005  # mean length of one slip


@dataclass(frozen=True, kw_only=True)
class NoiseConfig(Settings):
    """Noise of the channels."""

    electrode_counts: float = setting(4.2, "Standard deviation of the white noise of an electrode", bounds=(0.0, 1e6))
    pdc_counts: float = setting(0.3, "Standard deviation of the white noise of PDC", bounds=(0.0, 1e6))


@dataclass(frozen=True, kw_only=True)
class TemperatureConfig(Settings):
    """Warming of the liquid, which moves all counts; it is not compensated in the sensor."""

    body_kelvin: float = setting(3.0, "Rise of the liquid's temperature since power-on, in the end", bounds=(-1e3, 1e3))
    warming_s: float = setting(600.0, "Time constant of the warming", bounds=(1e-3, 1e9))


def ou_noise(
    rows: int, channels: int, counts: float, memory_s: float, rate_hz: float, rng: np.random.Generator
) -> Float64:
    """(rows, channels) Ornstein-Uhlenbeck noise, stationary from its first row.

    x_t = a x_{t-1} + √(1 - a²) ε_t with a = exp(-1 / (rate · memory)), of standard deviation `counts`.
    """
    a = float(np.exp(-1.0 / (rate_hz * memory_s)))
    steps = counts * rng.standard_normal((rows, channels))
    steps[1:] *= np.sqrt(1.0 - a * a)
    for t in range(1, rows):
        steps[t] += a * steps[t - 1]
    return steps


def scan(series: Float64, rng: np.random.Generator) -> Float64:
    """Sample the channels of a series (T, C) in a ring: each message repeats those that were not sampled since the last."""
    rows, channels = series.shape
    cuts = rng.uniform(0.0, channels) + _FRESH_PER_ROW * np.arange(rows + 1)
    cuts += _CUT_JITTER * rng.standard_normal(rows + 1)
    cursor = np.maximum.accumulate(np.floor(cuts).astype(np.int64))
    fresh = (np.arange(channels) - cursor[:-1, None]) % channels < np.diff(cursor)[:, None]
    fresh[:1] = True
    sampled = np.where(fresh, np.arange(rows)[:, None], 0)
    return np.asarray(np.take_along_axis(series, np.maximum.accumulate(sampled, axis=0), axis=0))


@dataclass(frozen=True, kw_only=True)
class CreepConfig(Settings):
    """The skin relaxes under load within seconds; with a slow share, a part of the response comes later still."""

    slow_share: float = setting(0.0, "Part of the response that comes later still", bounds=(0.0, 0.9))
    slow_s: float = setting(30.0, "Time constant of that part", bounds=(0.1, 1e5))


def creep(series: Float64, rate_hz: float, *, share: float = CREEP_SHARE, time_s: float = CREEP_TIME_S) -> Float64:
    """The skin as a standard linear solid: y = (1 - share) x + share · z, with dz/dt = (x - z) / time, at rest at first.

    A constant load creeps on, a released one leaves a rest that fades, and a cycle of load encloses an area:
    relaxation and hysteresis are one effect. `series` (T, ...) is the response x of an ideal fingertip, T at least 1.
    """
    late = np.array(series[0], np.float64)
    pull = -np.expm1(-1.0 / (rate_hz * time_s))
    result = np.empty_like(series, dtype=np.float64)
    for t, value in enumerate(series):
        late = late + pull * (value - late)
        result[t] = (1.0 - share) * value + share * late
    return result


def warming(config: TemperatureConfig, times_s: Float64) -> Float64:
    """(T,) float64: rise of the liquid's temperature [K] at times since power-on [s]."""
    return np.asarray(config.body_kelvin * -np.expm1(-times_s / config.warming_s))


def temperature_drift(config: TemperatureConfig, times_s: Float64) -> Float64:
    """(T, 25) float64: drift of PDC and electrodes [counts] at times (T,) since power-on [s]."""
    return np.outer(warming(config, times_s), [PDC_PER_KELVIN, *[ELECTRODE_PER_KELVIN] * ELECTRODES])


def mask_dead_electrodes(series: Float64, dead: Sequence[int], stuck_at: str = "low") -> Float64:
    """A series (T, 24) in which some electrodes, 0 to 23, read 0 (`low`), 4095 (`high`) or their first count (`last`)."""
    result, columns = series.copy(), list(dead)
    stuck: dict[str, Float64 | float] = {"low": 0.0, "high": float(FULL_SCALE), "last": result[:1, columns]}
    result[:, columns] = stuck[stuck_at]
    return result


def slip_path(rows: int, rate_hz: float, rng: np.random.Generator) -> Float64:
    """(rows,) float64 [m]: how far the object has slid in the tangent plane, starting at 0, never back.

    It sticks for exponentially distributed times and slips by exponentially distributed lengths, which keep the mean speed.
    """
    slips = rng.poisson(SLIP_SPEED_M_S / (SLIP_LENGTH_M * rate_hz), rows)
    path = np.cumsum(rng.standard_gamma(np.maximum(slips, 1)) * SLIP_LENGTH_M * (slips > 0))
    return np.asarray(path - path[0]) if rows else path
