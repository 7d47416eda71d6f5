# SPDX-License-Identifier: Apache-2.0
"""Effects with memory: creep of the skin, drift with temperature, electrodes that died, slip."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from foretouch.config import Settings, setting
from foretouch.errors import TactileError
from foretouch.tactile import FULL_SCALE
from foretouch.types import Float64


@dataclass(frozen=True, kw_only=True)
class CreepConfig(Settings):
    """The skin as a standard linear solid."""

    share: float = setting(0.08, "Part of the answer that comes late", minimum=0.0, maximum=1.0)
    time_s: float = setting(1.5, "Time in which the late part comes", unit="s", minimum=1e-3)


@dataclass(frozen=True, kw_only=True)
class TemperatureConfig(Settings):
    """How counts move with the liquid's temperature; not compensated in the sensor.

    The coefficients are orders of magnitude, not measurements: they differ from sensor to sensor.
    """

    body_kelvin: float = setting(3.0, "How much warmer than at power-up the liquid gets", unit="K")
    warming_s: float = setting(600.0, "Time constant of the warming", unit="s", minimum=1e-3)
    electrode_counts_per_kelvin: float = setting(12.0, "Rise of an electrode", unit="counts/K")
    pdc_counts_per_kelvin: float = setting(8.0, "Rise of PDC", unit="counts/K")


@dataclass(frozen=True, kw_only=True)
class SlipConfig(Settings):
    """Sliding of the object over the skin, in sticks and slips."""

    speed_m_s: float = setting(0.005, "Mean speed", unit="m/s", minimum=0.0)
    stick_m: float = setting(0.0005, "Mean length of one slip", unit="m", minimum=1e-6)


def creep(config: CreepConfig, series: Float64, rate_hz: float, start: Float64 | None = None) -> Float64:
    """The skin's late answer: y = (1 - share) x + share · z, with dz/dt = (x - z) / time.

    A constant load creeps on, a released one leaves a rest that fades, and a cycle of load encloses an area:
    relaxation and hysteresis are one effect.

    Args:
        config: The skin.
        series: (T, ...) float64, what an ideal fingertip would answer.
        rate_hz: Of its rows [Hz].
        start: (...) state z before the first row; by default the first row, a skin at ease.
    """
    late = np.array(series[0] if start is None else start, np.float64) if len(series) else np.empty(0)
    pull = -np.expm1(-1.0 / (rate_hz * config.time_s))
    result = np.empty_like(series, dtype=np.float64)
    for t, value in enumerate(series):
        late = late + pull * (value - late)
        result[t] = (1.0 - config.share) * value + config.share * late
    return result


def warming(config: TemperatureConfig, times_s: Float64) -> Float64:
    """Temperature of the liquid above that at power-up [K], at times since then [s]."""
    return np.asarray(config.body_kelvin * -np.expm1(-np.asarray(times_s) / config.warming_s))


def temperature_drift(config: TemperatureConfig, kelvin: Float64) -> tuple[Float64, Float64]:
    """Offsets of PDC and of each electrode [counts] at a temperature above that of the tare [K]."""
    return config.pdc_counts_per_kelvin * kelvin, config.electrode_counts_per_kelvin * kelvin


def kill_electrodes(series: Float64, dead: Sequence[int], stuck_at: Literal["low", "high", "last"] = "low") -> Float64:
    """The same series with some electrodes dead.

    Args:
        series: (T, 24) or (24,) [counts].
        dead: Which, 0 to 23.
        stuck_at: 0 counts, 4095 counts, or the first row's.

    Raises:
        TactileError: If there is no such electrode or way to be stuck.
    """
    if stuck_at not in {"low", "high", "last"}:
        raise TactileError(f"stuck_at: {stuck_at!r} is none of low, high, last")
    wrong = [k for k in dead if not 0 <= k < series.shape[-1]]
    if wrong:
        raise TactileError(f"dead: no electrode {wrong[0]}, there are {series.shape[-1]}")
    result = np.array(series, np.float64)
    for k in dead:
        last = float(np.atleast_2d(series)[0, k])
        result[..., k] = {"low": 0.0, "high": float(FULL_SCALE), "last": last}[stuck_at]
    return result


def slip_path(config: SlipConfig, rows: int, rate_hz: float, rng: np.random.Generator) -> Float64:
    """(rows,) float64 [m]: how far the object has slid, starting at 0, never back.

    It sticks for exponentially distributed times and slips by exponentially distributed lengths, which
    keep the mean speed. Whoever simulates the contact moves it by so much in the tangent plane.
    """
    slips = rng.poisson(config.speed_m_s / (config.stick_m * rate_hz), rows)
    lengths = rng.standard_gamma(np.maximum(slips, 1)) * config.stick_m * (slips > 0)
    path = np.cumsum(lengths)
    return np.asarray(path - path[0]) if rows else path
