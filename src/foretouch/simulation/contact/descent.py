# SPDX-License-Identifier: Apache-2.0
"""Conjugate gradients under the bound p >= 0 (Polonsky & Keer 1999, their steps 1 to 8)."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from foretouch.simulation.contact.influence import Complex128, convolve
from foretouch.types import Float64

__all__ = ["Descent"]

_TINY = float(np.finfo(np.float64).tiny)


class Descent:
    """The pressure on its way to contact.

    Where neither clipping nor new cells disturb a step, K p follows from K t of the step instead of a
    second convolution.

    Args:
        gap: (N, N) float64, finite [m].
        spectrum: Of the influence coefficients.
        start: (N, N) float64 [Pa], at least 0 and somewhere above.
        depth: Approach [m], or None if `total` is given.
        total: Σ pressure over the cells [Pa], or None if `depth` is given.

    Attributes:
        pressure: (N, N) float64 [Pa].
        depth: The given approach, or the one that the present pressure means [m].
        iterations: Steps taken.
        residual: Change of pressure in the last step over the pressure, both summed.
    """

    def __init__(
        self, gap: Float64, spectrum: Complex128, start: Float64, *, depth: float | None, total: float | None
    ) -> None:
        self._gap = gap
        self._spectrum = spectrum
        self._safe_length = 1.0 / float(np.abs(spectrum).max())  # below 2 / (largest eigenvalue of K)
        self._given_depth = depth
        self._total = total
        self.pressure = start if total is None else start * (total / float(start.sum()))
        self._displacement = convolve(self.pressure, spectrum)
        self._direction = np.zeros_like(gap)
        self._last_squares = math.inf  # the first direction is the gradient itself
        self.iterations = 0
        self.residual = math.inf

    @property
    def depth(self) -> float:
        """The approach [m]: at a given force, the mean that the cells in contact ask for."""
        return self._depth(self.pressure > 0.0)

    def step(self) -> float:
        """Take one step; returns `residual`."""
        wet = self.pressure > 0.0
        r = self._displacement + self._gap
        r -= self._depth(wet)
        g = r * wet
        squares = float(np.vdot(g, g))
        t = g + (squares / self._last_squares) * (self._direction * wet)
        q = convolve(t, self._spectrum)
        bend = float(np.vdot(t, q))
        if self._total is not None:  # the depth is free: only what departs from the mean counts
            bend -= float(t.sum()) * float(np.vdot(q, wet)) / max(int(np.count_nonzero(wet)), 1)
        length = float(np.vdot(g, t)) / bend if bend > 0.0 else self._safe_length
        self._direction, self._last_squares = t, squares if squares > 0.0 else math.inf
        self._apply(length, t, q, r, wet)
        return self.residual

    def _depth(self, wet: npt.NDArray[np.bool_]) -> float:
        if self._given_depth is not None:
            return self._given_depth
        return float(np.vdot(self._displacement + self._gap, wet)) / int(np.count_nonzero(wet))

    def _apply(self, length: float, t: Float64, q: Float64, r: Float64, wet: npt.NDArray[np.bool_]) -> None:
        old = self.pressure
        new = old - length * t
        negative = new < 0.0
        overlap = (r < 0.0) & ~wet
        grown = bool(overlap.any())
        if grown:  # cells that overlap join, by a step that cannot overshoot, and the directions start anew
            new[overlap] -= min(length, self._safe_length) * r[overlap]
            self._last_squares = math.inf
        if negative.any():
            new[negative] = 0.0
            grown = True
        self._displacement = convolve(new, self._spectrum) if grown else self._displacement - length * q
        total = float(new.sum())
        if self._total is not None and total > 0.0:
            new *= self._total / total
            self._displacement *= self._total / total
        self.pressure = new
        self.iterations += 1
        self.residual = float(np.abs(new - old).sum()) / max(total, _TINY)
