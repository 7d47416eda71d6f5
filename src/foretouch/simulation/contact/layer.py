# SPDX-License-Identifier: Apache-2.0
"""Contact of elastic layers or half-spaces: constrained conjugate gradients (Polonsky & Keer 1999).

The start of the iteration is guessed in closed form. A thick layer answers like a half-space, whose mean stiffness under a footprint of radius a is
4√2 / (3π) E* / a (from Hertz); a thin one like its bed of springs. The two are added. Between the limits
the footprint shrinks from all cells that overlap (bed) to half that depth (Hertz), and the profile
turns from linear in the overlap to its square root.

`Descent` minimises under the bound p >= 0 (their steps 1 to 8). With K the influence of pressure on displacement, the pressure solves

    p >= 0,   r = K p + g - d >= 0,   p r = 0,

at a given depth d, or at the depth for which Σ p · cell is the given force. Products with K are
convolutions by FFT (`influence`). The descent runs on the part of the window that the footprint is
expected in; the result is then checked on the whole window, and solved there if it does not hold.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from foretouch.errors import ConvergenceError
from foretouch.simulation.contact.influence import Complex128, convolve, influence_spectrum
from foretouch.simulation.contact.problem import (
    DEFAULT_CONFIG,
    Command,
    ContactConfig,
    ContactProblem,
    ContactSolution,
    no_contact,
    refuse_overload,
)
from foretouch.simulation.contact.winkler import bed_stiffness
from foretouch.types import Float64

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


_HERTZ = 4.0 * math.sqrt(2.0) / (3.0 * math.pi)
_SIZES = (8, 12, 16, 20, 24, 32, 40, 48, 64, 80, 96, 128)  # few, so that the spectra kept suffice


@dataclass(frozen=True)
class Box:
    """A square part of the window.

    Attributes:
        size: Its side [cells].
        row, column: Its first cell.
    """

    size: int
    row: int
    column: int

    @property
    def rows(self) -> slice:
        """Its rows."""
        return slice(self.row, self.row + self.size)

    @property
    def columns(self) -> slice:
        """Its columns."""
        return slice(self.column, self.column + self.size)

    @classmethod
    def around(cls, pressure: Float64, margin: int) -> Box:
        """The smallest of a few sizes that holds all pressed cells and `margin` more on each side."""
        n = pressure.shape[0]
        spans = [np.flatnonzero(pressure.any(axis=axis)) for axis in (1, 0)]
        needed = max(int(span[-1] - span[0]) for span in spans) + 1 + 2 * margin
        size = min(next((s for s in _SIZES if s >= needed), n), n)
        row, column = (min(max((int(s[0] + s[-1]) + 1 - size) // 2, 0), n - size) for s in spans)
        return cls(size, row, column)


def expected_pressure(problem: ContactProblem, command: Command) -> Float64:
    """(N, N) float64 [Pa]: at least one cell is pressed; all pressed ones have a finite gap."""
    gaps = np.sort(problem.gap[np.isfinite(problem.gap)], axis=None)
    count = np.arange(1, gaps.size + 1)
    radius = np.sqrt(count * problem.cell_m2 / math.pi)
    stiffness = _stiffness(problem, radius)
    if command.depth_m is None:
        # Force at which the contact reaches each gap in turn, as the overlap of all nearer cells.
        forces = stiffness * (count * gaps - np.cumsum(gaps)) * problem.cell_m2
        k = max(int(np.searchsorted(forces, float(command.force_n or 0.0))) - 1, 0)
        depth = float(command.force_n or 0.0) / (stiffness[k] * count[k] * problem.cell_m2) + float(
            gaps[: k + 1].mean()
        )
    else:
        depth = command.depth_m
        k = max(int(np.searchsorted(gaps, depth)) - 1, 0)
    beds = stiffness[k] - 1.0 / sum(radius[k] / (_HERTZ * layer.plane_modulus_pa) for layer in problem.layers)
    bed_share = min(max(float(beds / stiffness[k]), 0.0), 1.0)
    reach = depth * (1.0 + bed_share) / 2.0
    overlap = np.maximum(1.0 - problem.gap / reach, 0.0)
    shape: Float64 = overlap ** ((1.0 + bed_share) / 2.0)
    mean = float(stiffness[k]) * (depth - float(gaps[: k + 1].mean())) * (k + 1)
    return np.asarray(shape * (mean / float(shape.sum())))


def _stiffness(problem: ContactProblem, radius: npt.NDArray[np.float64]) -> Float64:
    compliance = np.zeros_like(radius)
    for layer in problem.layers:
        bed = 0.0 if math.isinf(layer.thickness_m) else bed_stiffness(layer)
        compliance += 1.0 / (bed + _HERTZ * layer.plane_modulus_pa / radius)
    return np.asarray(1.0 / compliance)


_ABSENT_M = 1e9  # stands for an infinite gap: finite, so that 0 pressure times it is 0, and out of reach
_MARGIN = 2  # cells around the expected footprint
_OVERLAP = 2e-2  # of the depth: how far the surfaces may still overlap before it is solved again on the window


def solve_layer(problem: ContactProblem, command: Command, config: ContactConfig = DEFAULT_CONFIG) -> ContactSolution:
    """Press two bodies together, each cell answering to all others.

    Args:
        problem: Surfaces and layers.
        command: A force or a depth.
        config: Tolerance and limits.

    Raises:
        ConvergenceError: If it does not converge in `max_iterations`.
        ContactError: If a layer is compressed beyond `max_strain`.
    """
    if command.idle:
        return no_contact(problem, command.depth_m or 0.0)
    gap = np.minimum(problem.gap, _ABSENT_M)
    pressure, end = _solve_in_box(problem, command, config, gap)
    displacement = _displacements(problem, pressure)
    if end.residual >= config.tolerance or _overlap(displacement, gap, end.depth) > _OVERLAP * abs(end.depth):
        end = _solve_in_window(problem, command, config, gap, end.iterations)
        pressure, displacement = end.pressure, _displacements(problem, end.pressure)
    refuse_overload(problem, displacement, end.depth, config)
    force = float(pressure.sum()) * problem.cell_m2
    area = int(np.count_nonzero(pressure)) * problem.cell_m2
    return ContactSolution(pressure, displacement, force, area, end.depth, end.iterations, end.residual)


def _solve_in_box(
    problem: ContactProblem, command: Command, config: ContactConfig, gap: Float64
) -> tuple[Float64, Descent]:
    """The pressure on the window, if only the expected footprint and its margin may carry any."""
    guess = expected_pressure(problem, command)
    box = Box.around(guess, _MARGIN)
    end = _descend(problem, command, config, gap[box.rows, box.columns], guess[box.rows, box.columns])
    pressure = np.zeros_like(gap)
    pressure[box.rows, box.columns] = end.pressure
    return pressure, end


def _solve_in_window(
    problem: ContactProblem, command: Command, config: ContactConfig, gap: Float64, spent: int
) -> Descent:
    """From even pressure wherever both surfaces exist: slower, and sure where the guess misled."""
    even = np.isfinite(problem.gap) * (problem.contact_modulus_pa * 1e-3)
    end = _descend(problem, command, config, gap, even)
    end.iterations += spent
    if end.residual >= config.tolerance:
        raise ConvergenceError(
            f"elastic layer: no convergence after {end.iterations} iterations on {gap.shape[0]}^2 cells, "
            f"{np.count_nonzero(end.pressure)} of them in contact: "
            f"residual {end.residual:.3g}, tolerance {config.tolerance:g}"
        )
    return end


def _descend(problem: ContactProblem, command: Command, config: ContactConfig, gap: Float64, start: Float64) -> Descent:
    """Step until the tolerance is met or the iterations are spent."""
    total = None if command.force_n is None else command.force_n / problem.cell_m2
    descent = Descent(gap, _spectra(problem, gap.shape[0]).sum(axis=0), start, depth=command.depth_m, total=total)
    while descent.iterations < config.max_iterations and descent.step() >= config.tolerance:
        pass
    return descent


def _spectra(problem: ContactProblem, n: int) -> Complex128:
    """(L, 2n, n + 1), of each layer."""
    return np.stack([influence_spectrum(layer, n, problem.step_m) for layer in problem.layers])


def _displacements(problem: ContactProblem, pressure: Float64) -> Float64:
    return convolve(pressure, _spectra(problem, pressure.shape[0]))


def _overlap(displacement: Float64, gap: Float64, depth: float) -> float:
    """How far the surfaces, displaced, still pass through each other anywhere [m]."""
    return depth - float((displacement.sum(axis=0) + gap).min())
