# SPDX-License-Identifier: Apache-2.0
"""Disturbances of the counts: noise, a slow scan, creep of the skin, drift with temperature, dead electrodes and slip.

The defaults are fitted to recordings of a BioTac SP in steady touch at 100 Hz (see `steady_noise`). The
electrodes are sampled one after the other in a ring; each message takes what has been sampled since
the last one, about 17 of 24, and repeats the rest: a block of about eight that moves on from row to row.
`steady_noise` estimates the noise of steady counts, for recordings and for the simulation alike.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from foretouch.config import Settings, setting
from foretouch.errors import TactileError
from foretouch.tactile import FULL_SCALE
from foretouch.types import Float64


@dataclass(frozen=True, kw_only=True)
class NoiseConfig(Settings):
    """Noise of the channels."""

    electrode_counts: float = setting(4.2, "White noise of an electrode (std)", unit="counts", minimum=0.0, maximum=1e6)
    pdc_counts: float = setting(0.3, "White noise of PDC (std)", unit="counts", minimum=0.0, maximum=1e6)
    wander_counts: float = setting(1.9, "Slow wander of an electrode (std)", unit="counts", minimum=0.0, maximum=1e6)
    wander_s: float = setting(0.4, "Time over which the wander forgets itself", unit="s", minimum=1e-3, maximum=1e6)


@dataclass(frozen=True, kw_only=True)
class ScanConfig(Settings):
    """The ring of electrodes."""

    fresh_per_row: float = setting(16.8, "Electrodes sampled between two messages", minimum=1.0, maximum=24.0)
    jitter: float = setting(
        1.0, "Standard deviation of where a message cuts the ring", unit="electrodes", minimum=0.0, maximum=1e3
    )


def white_noise(shape: tuple[int, ...], counts: float, rng: np.random.Generator) -> Float64:
    """Independent normal noise of the given shape and standard deviation [counts]."""
    return counts * rng.standard_normal(shape)


def wander(
    rows: int, channels: int, counts: float, memory_s: float, rate_hz: float, rng: np.random.Generator
) -> Float64:
    """(rows, channels) first-order autoregressive noise, stationary from its first row.

    x_t = a x_{t-1} + √(1 - a²) ε_t with a = exp(-1 / (rate · memory)).

    Args:
        rows: Messages.
        channels: Of each.
        counts: Standard deviation [counts].
        memory_s: Time in which the autocorrelation falls to 1/e [s].
        rate_hz: Of the messages [Hz].
        rng: Of the noise.
    """
    a = float(np.exp(-1.0 / (rate_hz * memory_s)))
    steps = counts * rng.standard_normal((rows, channels))
    steps[1:] *= np.sqrt(1.0 - a * a)
    for t in range(1, rows):
        steps[t] += a * steps[t - 1]
    return steps


def fresh_samples(config: ScanConfig, rows: int, channels: int, rng: np.random.Generator) -> npt.NDArray[np.bool_]:
    """(rows, channels) bool: which values of each message are new; all of the first.

    Args:
        config: The ring.
        rows: Messages.
        channels: Electrodes in the ring.
        rng: Of where the ring starts and of the jitter.
    """
    cuts = rng.uniform(0.0, channels) + config.fresh_per_row * np.arange(rows + 1)
    cuts += config.jitter * rng.standard_normal(rows + 1)
    cursor = np.maximum.accumulate(np.floor(cuts).astype(np.int64))
    since_cut = (np.arange(channels) - cursor[:-1, None]) % channels
    fresh = since_cut < np.diff(cursor)[:, None]
    fresh[:1] = True
    return np.asarray(fresh, np.bool_)


def hold(series: Float64, fresh: npt.NDArray[np.bool_]) -> Float64:
    """Repeat the last fresh value of each channel.

    Args:
        series: (T, C).
        fresh: (T, C) bool, true throughout the first row.

    Raises:
        TactileError: If the shapes differ or a channel has no first value.
    """
    if series.shape != fresh.shape:
        raise TactileError(f"fresh: shape {fresh.shape} is not that of the series, {series.shape}")
    if len(fresh) and not fresh[0].all():
        raise TactileError(f"fresh: {np.count_nonzero(~fresh[0])} channels have no first value")
    rows = np.where(fresh, np.arange(len(series))[:, None], 0)
    return np.asarray(np.take_along_axis(series, np.maximum.accumulate(rows, axis=0), axis=0))


_FEWEST_ROWS = 10


@dataclass(frozen=True)
class SteadyNoise:
    """Noise of electrodes in steady touch.

    Attributes:
        sd: Standard deviation of the white part [counts]: root mean square of the steps that move, over √2.
            A slow change hardly enters a step, and a repeated value none.
        repeated: Share of values equal to the one before.
        lag1: Autocorrelation at one row about each channel's straight line, median of the channels.
    """

    sd: float
    repeated: float
    lag1: float


def steady_noise(series: Sequence[npt.ArrayLike]) -> SteadyNoise:
    """Estimate the noise of one or more series.

    Args:
        series: Each (T, C) counts at a steady rate; T and C may differ.

    Raises:
        TactileError: If there is none, one has fewer than ten rows, or nothing moves in any.
    """
    steps: list[npt.NDArray[np.float64]] = []
    lags: list[npt.NDArray[np.float64]] = []
    for k, one in enumerate(series):
        counts = np.asarray(one, np.float64)
        if counts.ndim != 2 or len(counts) < _FEWEST_ROWS:
            raise TactileError(f"series[{k}]: shape {counts.shape} is not (T, C) with T at least {_FEWEST_ROWS}")
        steps.append(np.diff(counts, axis=0).ravel())
        lags.append(_lag1(counts))
    every = np.concatenate(steps) if steps else np.empty(0)
    moves = every[every != 0.0]
    if not moves.size:
        raise TactileError("series: nothing moves in any of them")
    sd = math.sqrt(float(np.mean(moves**2)) / 2.0)
    return SteadyNoise(sd, 1.0 - moves.size / every.size, float(np.median(np.concatenate(lags))))


def _lag1(counts: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Of each channel that departs from its straight line."""
    time = np.arange(len(counts)) - (len(counts) - 1) / 2.0
    rest = counts - counts.mean(axis=0)
    rest = rest - np.outer(time, time @ rest / (time @ time))
    squares = np.einsum("tc,tc->c", rest, rest)
    moving = squares > 0.0
    return np.asarray(np.einsum("tc,tc->c", rest[1:], rest[:-1])[moving] / squares[moving])


@dataclass(frozen=True, kw_only=True)
class CreepConfig(Settings):
    """The skin as a standard linear solid."""

    share: float = setting(0.08, "Part of the answer that comes late", minimum=0.0, maximum=1.0)
    time_s: float = setting(1.5, "Time in which the late part comes", unit="s", minimum=1e-3, maximum=1e6)


@dataclass(frozen=True, kw_only=True)
class TemperatureConfig(Settings):
    """How counts move with the liquid's temperature; not compensated in the sensor.

    The coefficients are orders of magnitude, not measurements: they differ from sensor to sensor.
    """

    body_kelvin: float = setting(
        3.0, "How much warmer than at power-up the liquid gets", unit="K", minimum=-1e3, maximum=1e3
    )
    warming_s: float = setting(600.0, "Time constant of the warming", unit="s", minimum=1e-3, maximum=1e9)
    electrode_counts_per_kelvin: float = setting(
        12.0, "Rise of an electrode", unit="counts/K", minimum=-1e4, maximum=1e4
    )
    pdc_counts_per_kelvin: float = setting(8.0, "Rise of PDC", unit="counts/K", minimum=-1e4, maximum=1e4)


@dataclass(frozen=True, kw_only=True)
class SlipConfig(Settings):
    """Sliding of the object over the skin, in sticks and slips."""

    speed_m_s: float = setting(0.005, "Mean speed", unit="m/s", minimum=0.0, maximum=10.0)
    stick_m: float = setting(0.0005, "Mean length of one slip", unit="m", minimum=1e-6, maximum=1.0)


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
