# SPDX-License-Identifier: Apache-2.0
"""A bed of springs (Winkler; Johnson 1985, section 4.3), in which the cells are independent.

p = k d, d the overlap of the undeformed surfaces. A layer of thickness h that cannot give way sideways
has k = E (1 - ν) / ((1 + ν) (1 - 2ν)) / h, which is E / h at ν = 0. Beds in series: 1/k = Σ 1/k_i.
It is right for layers thin against the contact; towards ν = 0.5 or thick layers, use the elastic layer.
"""

import math

import numpy as np

from foretouch.errors import ContactError
from foretouch.types import Float64
from foretouch_lab.simulation.contact.problem import (
    Command,
    ContactProblem,
    ContactSolution,
    ElasticLayer,
    no_contact,
    refuse_overload,
)

_MAX_POISSON = 0.45  # beyond, the confined modulus depends more on ν than on the material


def bed_stiffness(layer: ElasticLayer) -> float:
    """Pressure per indentation of one layer [Pa/m].

    ν is capped at 0.45: an incompressible layer does not answer locally, and its bed would be rigid.

    Raises:
        ContactError: If the layer is a half-space, which has no bed.
    """
    if math.isinf(layer.thickness_m):
        raise ContactError("thickness_m: a half-space has no Winkler bed; use the elastic layer")
    nu = min(layer.poisson, _MAX_POISSON)
    confined = layer.modulus_pa * (1.0 - nu) / ((1.0 + nu) * (1.0 - 2.0 * nu))
    return confined / layer.thickness_m


def solve_winkler(problem: ContactProblem, command: Command) -> ContactSolution:
    """Press two bodies together on a bed of springs; exact, without iteration.

    Raises:
        ContactError: If a layer is a half-space or compressed beyond `max_strain`.
    """
    if command.idle:
        return no_contact(problem, command.depth_m or 0.0)
    compliances = np.array([1.0 / bed_stiffness(layer) for layer in problem.layers])
    k = 1.0 / float(compliances.sum())
    if command.depth_m is None:
        depth = _depth_for(problem.gap, float(command.force_n or 0.0) / (k * problem.cell_m2))
    else:
        depth = command.depth_m
    pressure = k * np.maximum(depth - problem.gap, 0.0)
    displacement = compliances[:, None, None] * pressure
    refuse_overload(problem, displacement, depth)
    area = int(np.count_nonzero(pressure)) * problem.cell_m2
    return ContactSolution(pressure, displacement, float(pressure.sum()) * problem.cell_m2, area, depth)


def _depth_for(gap: Float64, overlap_sum: float) -> float:
    """The depth d at which Σ max(d - gap, 0) is `overlap_sum`.

    The sum is piecewise linear in d with a kink at every gap. With the gaps in order, the n-th piece gives
    d = (overlap_sum + Σ first n gaps) / n; it is the one whose d does not reach the next gap.
    """
    # The deepest the bed can go: all cells share the sum. Farther cells than a lone one would reach stay dry.
    candidates = np.sort(gap[gap <= overlap_sum], axis=None)  # holds the cell with gap 0
    depths = (overlap_sum + np.cumsum(candidates)) / np.arange(1, candidates.size + 1)
    pieces = np.flatnonzero(depths[:-1] <= candidates[1:])
    return float(depths[pieces[0]] if pieces.size else depths[-1])
