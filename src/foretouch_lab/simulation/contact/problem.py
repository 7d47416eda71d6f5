# SPDX-License-Identifier: Apache-2.0
"""The contact problem and its solution, the bed of springs, and the forces along the skin.

Two bodies meet across a gap. Each is a stack-free elastic layer bonded to a rigid base: the skin on the
core of the fingertip and, if it is soft, the object. Only normal, frictionless contact is solved; strains
are taken as small.

A bed of springs (Winkler; Johnson 1985, section 4.3), in which the cells are independent: p = k d, d the overlap of the
undeformed surfaces. A layer of thickness h that cannot give way sideways has k = E (1 - ν) / ((1 + ν) (1 - 2ν)) / h,
which is E / h at ν = 0. Beds in series: 1/k = Σ 1/k_i. It is right for layers thin against the contact; towards ν = 0.5
or thick layers, use the elastic layer.

Forces along the skin go with a solved contact by its slope and by friction. Pressure acts along the normal of the skin as
it is pressed in; where that is inclined by the slopes s to the plane of the contact, it pushes along that plane by p s.
Friction carries what is missing to the force T that the finger exerts along it:

    Q = T - Σ p s · cell, at most µ N (Coulomb),        q = µ (p(N) - p(N - Q/µ)) along Q

with p(N) the pressure under the normal force N. That is the partial slip of Cattaneo and Mindlin for any shape of contact
(Ciavarella 1998, Jäger 1998): inside of the contact of the smaller force the surfaces stick, and q <= µ p everywhere.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np

from foretouch.errors import ContactError
from foretouch.types import Float64

MAX_STRAIN = 0.95  # deepest compression of a layer over its thickness
_LEAST: Final = 1e-12  # [N] or [m]: less is no contact


@dataclass(frozen=True, kw_only=True)
class ElasticLayer:
    """An isotropic elastic layer, bonded to a rigid base."""

    modulus_pa: float  # Young's modulus E [Pa]
    poisson: float  # Poisson's ratio ν, 0 to 0.5
    thickness_m: float = math.inf  # h [m]; infinite for a half-space

    @property
    def plane_modulus_pa(self) -> float:
        """E / (1 - ν²) [Pa], the modulus of a half-space in contact (Johnson 1985, eq. 4.5)."""
        return self.modulus_pa / (1.0 - self.poisson**2)


@dataclass(frozen=True, kw_only=True)
class Command:
    """The command of a finger: either a force or a depth."""

    force_n: float | None = None  # normal force, at least 0 [N]
    depth_m: float | None = None  # approach of the bodies beyond first touch [m]; none or negative is no contact

    @property
    def idle(self) -> bool:
        """Whether it asks for no contact at all."""
        return float((self.force_n if self.depth_m is None else self.depth_m) or 0.0) < _LEAST


@dataclass(frozen=True, eq=False)
class ContactProblem:
    """Two surfaces on a square grid, at first touch.

    Attributes:
        gap: (N, N) float64 [m], distance of the undeformed surfaces, its least value 0; infinite where one of
            them is absent. Row i runs along the tangent y, column j along the tangent x.
        step_m: Side of a cell [m].
        layers: The compliant bodies, the pad's first.
    """

    gap: Float64
    step_m: float
    layers: tuple[ElasticLayer, ...]

    @property
    def cell_m2(self) -> float:
        """Area of a cell [m²]."""
        return self.step_m**2

    @property
    def contact_modulus_pa(self) -> float:
        """E* with 1/E* = Σ (1 - ν²)/E (Johnson 1985, eq. 4.5) [Pa]."""
        return 1.0 / sum(1.0 / layer.plane_modulus_pa for layer in self.layers)


@dataclass(frozen=True, eq=False)
class ContactSolution:
    """A solved contact."""

    pressure: Float64  # (N, N) float64, at least 0 [Pa]
    displacement: Float64  # (L, N, N) float64 [m], how far each layer's surface is pushed in
    force_n: float  # Σ pressure · cell [N]
    area_m2: float  # area under pressure [m²]
    depth_m: float  # approach of the bodies beyond first touch [m]


def no_contact(problem: ContactProblem, depth_m: float = 0.0) -> ContactSolution:
    """Return the solution where nothing presses."""
    shape = problem.gap.shape
    return ContactSolution(np.zeros(shape), np.zeros((len(problem.layers), *shape)), 0.0, 0.0, min(depth_m, 0.0))


def refuse_overload(problem: ContactProblem, displacement: Float64, depth_m: float) -> None:
    """Refuse a solution that is deeper than the window is wide, or presses a layer through its base.

    Args:
        problem: The two surfaces.
        displacement: (L, N, N) how far each surface is pushed in [m].
        depth_m: Approach of the bodies [m].

    Raises:
        ContactError: Names the depth, or the layer and its strain, and the limit.
    """
    for k, layer in enumerate(problem.layers):
        strain = float(displacement[k].max()) / layer.thickness_m
        if strain > MAX_STRAIN:
            raise ContactError(
                f"layers[{k}]: compressed by {strain:.3g} of its {layer.thickness_m * 1e3:.3g} mm, "
                f"more than max_strain {MAX_STRAIN:g}: press less or make it stiffer"
            )
    side = problem.gap.shape[0] * problem.step_m
    if not depth_m <= side:
        raise ContactError(f"depth: {depth_m:.3g} m is more than the {side:.3g} m window is wide: press less")


_MAX_POISSON = 0.45  # beyond, the confined modulus depends more on ν than on the material


def bed_stiffness(layer: ElasticLayer) -> float:
    """Return the pressure per indentation of one layer that is not a half-space [Pa/m].

    ν is capped at 0.45: an incompressible layer does not answer locally, and its bed would be rigid.
    """
    nu = min(layer.poisson, _MAX_POISSON)
    confined = layer.modulus_pa * (1.0 - nu) / ((1.0 + nu) * (1.0 - 2.0 * nu))
    return confined / layer.thickness_m


def solve_winkler(problem: ContactProblem, command: Command) -> ContactSolution:
    """Press two bodies together on a bed of springs; exact, without iteration.

    Raises:
        ContactError: If a layer is compressed beyond `MAX_STRAIN`.
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
    """Return the depth d at which Σ max(d - gap, 0) is `overlap_sum`.

    The sum is piecewise linear in d with a kink at every gap. With the gaps in order, the n-th piece gives
    d = (overlap_sum + Σ first n gaps) / n; it is the one whose d does not reach the next gap.
    """
    # The deepest the bed can go: all cells share the sum. Farther cells than a lone one would reach stay dry.
    candidates = np.sort(gap[gap <= overlap_sum], axis=None)  # holds the cell with gap 0
    depths = (overlap_sum + np.cumsum(candidates)) / np.arange(1, candidates.size + 1)
    pieces = np.flatnonzero(depths[:-1] <= candidates[1:])
    return float(depths[pieces[0]] if pieces.size else depths[-1])


STEEPEST: Final = 1.0  # slope beyond which an edge counts as one of 45 degrees


def skin_slopes(depth: Float64, step_m: float) -> Float64:
    """Return (N, N, 2) slope of a surface along x and y from its depth (N, N) below a plane; 0 beside it, where depth is not finite.

    Args:
        depth: (N, N) below a plane; not finite beside the surface [m].
        step_m: Side of a cell [m].
    """
    height = np.where(np.isfinite(depth), -depth, np.nan)
    slopes = np.zeros((*depth.shape, 2))
    for k, axis in enumerate((1, 0)):
        steps = np.diff(height, axis=axis) / step_m
        before, after = (np.insert(steps, place, np.nan, axis=axis) for place in (0, steps.shape[axis]))
        known = np.isfinite(before).astype(np.int64) + np.isfinite(after)
        slopes[..., k] = (np.nan_to_num(before) + np.nan_to_num(after)) / np.maximum(known, 1)
    return np.clip(slopes, -STEEPEST, STEEPEST)


def tractions(
    contact: ContactSolution,
    cell_m2: float,
    slopes: Float64,
    tangential_n: Float64,
    friction: float,
    pressure_at: Callable[[float], Float64],
) -> Float64:
    """Return the force of an object on the skin, per area.

    Args:
        contact: The solved contact.
        cell_m2: Area of a cell [m²].
        slopes: (N, N, 2) of the pressed skin along x and y, as of `skin_slopes`.
        tangential_n: (2,) force of the object on the skin along x and y [N].
        friction: Coefficient µ.
        pressure_at: Gives the pressure (N, N) [Pa] under a smaller normal force [N].

    Returns:
        (N, N, 3) [Pa] along x, y and the outward normal; the last is minus the pressure.
    """
    pressure = contact.pressure
    along = pressure[..., None] * slopes
    missing = tangential_n - along.sum(axis=(0, 1)) * cell_m2
    size = float(np.linalg.norm(missing))
    if size > 0.0 and friction > 0.0:
        left_n = contact.force_n - size / friction
        sliding = pressure if left_n <= 0.0 else pressure - pressure_at(left_n)
        along = along + friction * np.maximum(sliding, 0.0)[..., None] * (missing / size)
    return np.concatenate([along, -pressure[..., None]], axis=-1)
