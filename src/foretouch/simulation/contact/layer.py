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

from foretouch.errors import ContactError
from foretouch.simulation.contact.descent import Descent
from foretouch.simulation.contact.footprint import Box, expected_pressure
from foretouch.simulation.contact.influence import Complex128, convolve, influence_spectrum
from foretouch.simulation.contact.problem import (
    Command,
    ContactConfig,
    ContactProblem,
    ContactSolution,
    no_contact,
    refuse_overload,
)
from foretouch.types import Float64

__all__ = ["solve_layer"]

_ABSENT_M = 1.0  # stands for an infinite gap: finite, so that 0 pressure times it is 0, and out of reach
_MARGIN = 2  # cells around the expected footprint
_OVERLAP = 1e-3  # of the depth: how far surfaces outside the box may overlap before it is solved again


def solve_layer(problem: ContactProblem, command: Command, config: ContactConfig | None = None) -> ContactSolution:
    """Press two bodies together, each cell answering to all others.

    Args:
        problem: Surfaces and layers.
        command: A force or a depth.
        config: Tolerance and limits.

    Raises:
        ContactError: If it does not converge in `max_iterations`, or a layer is compressed beyond `max_strain`.
    """
    config = config or ContactConfig()
    if command.idle:
        return no_contact(problem, command.depth_m or 0.0)
    n = problem.gap.shape[0]
    gap = np.minimum(problem.gap, _ABSENT_M)
    guess = expected_pressure(problem, command)
    box = Box.around(guess, _MARGIN)
    inner = _descend(problem, command, config, gap[box.rows, box.columns], guess[box.rows, box.columns])
    pressure = np.zeros_like(gap)
    pressure[box.rows, box.columns] = inner.pressure
    displacement = _displacements(problem, pressure)
    depth = inner.depth
    if box.size < n and _overlaps_outside(box, displacement.sum(axis=0) + gap - depth, depth):
        inner = _descend(problem, command, config, gap, pressure)
        pressure, depth = inner.pressure, inner.depth
        displacement = _displacements(problem, pressure)
    refuse_overload(problem, displacement, config)
    force = float(pressure.sum()) * problem.cell_m2
    area = np.count_nonzero(pressure) * problem.cell_m2
    return ContactSolution(pressure, displacement, force, area, depth, inner.iterations, inner.residual)


def _descend(problem: ContactProblem, command: Command, config: ContactConfig, gap: Float64, start: Float64) -> Descent:
    total = None if command.force_n is None else command.force_n / problem.cell_m2
    descent = Descent(gap, _spectrum(problem, gap.shape[0]), start, depth=command.depth_m, total=total)
    while descent.iterations < config.max_iterations:
        if descent.step() < config.tolerance:
            return descent
    raise ContactError(
        f"elastic layer: no convergence after {descent.iterations} iterations on {gap.shape[0]}^2 cells, "
        f"{np.count_nonzero(descent.pressure)} of them in contact: "
        f"residual {descent.residual:.3g}, tolerance {config.tolerance:g}"
    )


def _spectrum(problem: ContactProblem, n: int) -> Complex128:
    first, *others = (influence_spectrum(layer, n, problem.step_m) for layer in problem.layers)
    return sum(others, start=first)


def _displacements(problem: ContactProblem, pressure: Float64) -> Float64:
    n = pressure.shape[0]
    return np.stack([convolve(pressure, influence_spectrum(layer, n, problem.step_m)) for layer in problem.layers])


def _overlaps_outside(box: Box, distance: Float64, depth: float) -> bool:
    distance[box.rows, box.columns] = 0.0
    return float(distance.min()) < -_OVERLAP * depth
