# SPDX-License-Identifier: Apache-2.0
"""Noise of electrodes in steady touch, of recordings and of the simulation alike."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt


@dataclass(frozen=True)
class SteadyNoise:
    """Noise of electrodes in steady touch."""

    sd: float  # of the white part [counts]: root mean square of the steps that move, over √2; a slow change hardly enters
    repeated: float  # share of values equal to the one before
    lag1: float  # autocorrelation at one row about each channel's straight line, median of the channels that depart from it


def steady_noise(series: Sequence[npt.ArrayLike]) -> SteadyNoise:
    """Estimate the noise of series of (T, C) counts at a steady rate; T and C may differ."""
    rows = [np.asarray(one, np.float64) for one in series]
    steps = np.concatenate([np.diff(counts, axis=0).ravel() for counts in rows])
    moves = steps[steps != 0.0]
    lags = np.concatenate([_lag1(counts) for counts in rows])
    return SteadyNoise(math.sqrt(np.mean(moves**2) / 2.0), 1.0 - moves.size / steps.size, float(np.median(lags)))


def _lag1(counts: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    time = np.arange(len(counts)) - (len(counts) - 1) / 2.0
    rest = counts - counts.mean(axis=0)
    rest -= np.outer(time, time @ rest / (time @ time))
    squares = (rest**2).sum(axis=0)
    moving = squares > 0.0
    return np.asarray((rest[1:] * rest[:-1]).sum(axis=0)[moving] / squares[moving])
