# SPDX-License-Identifier: Apache-2.0
"""Where and how hard two bodies will press, guessed in closed form: the start of the iterative solver.

A thick layer answers like a half-space, whose mean stiffness under a footprint of radius a is
4√2 / (3π) E* / a (from Hertz); a thin one like its bed of springs. The two are added. Between the limits
the footprint shrinks from all cells that overlap (bed) to half that depth (Hertz), and the profile
turns from linear in the overlap to its square root.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from foretouch.simulation.contact.problem import Command, ContactProblem
from foretouch.simulation.contact.winkler import bed_stiffness
from foretouch.types import Float64

__all__ = ["Box", "expected_pressure"]

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
