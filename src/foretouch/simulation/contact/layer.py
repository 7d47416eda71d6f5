# SPDX-License-Identifier: Apache-2.0
"""Contact of elastic layers or half-spaces: constrained conjugate gradients (Polonsky & Keer 1999).

With K the influence of pressure on displacement, the pressure solves

    p >= 0,   r = K p + g - d >= 0,   p r = 0,

at a given depth d, or at the depth for which Σ p · cell is the given force. Products with K are
convolutions by FFT (`influence`). The descent runs on the part of the window that the footprint is
expected in; the result is then checked on the whole window, and solved there if it does not hold.
"""

from __future__ import annotations

import numpy as np

from foretouch.errors import ConvergenceError
from foretouch.simulation.contact.descent import Descent
from foretouch.simulation.contact.footprint import Box, expected_pressure
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
from foretouch.types import Float64

__all__ = ["solve_layer"]

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
