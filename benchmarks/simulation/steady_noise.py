# SPDX-License-Identifier: Apache-2.0
"""Noise of electrodes in steady touch, of recordings and of the simulation alike."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from foretouch.errors import TactileError

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
