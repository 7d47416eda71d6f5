# SPDX-License-Identifier: Apache-2.0
"""Contact in closed form: two smooth, thick bodies (Hertz), and a bed of springs (Winkler).

Hertz (Johnson 1985, section 4.2): two smooth, thick bodies.

The gap about first touch is A x² + B y² in its principal axes, A <= B. The footprint is an ellipse with
semi-axes a >= b, e² = 1 - b²/a², and with K, E the complete elliptic integrals of e (eqs. 4.26 to 4.28):

    B / A = ((a/b)² E - K) / (K - E),       a³ = 3 F D / (2π E* A),  D = (K - E) / e²,
    p = p0 √(1 - x²/a² - y²/b²),            p0 = 3 F / (2π a b),     depth = a² A K / D.

Layer thicknesses are left aside. Displacement is that of the circle of equal area, stretched to the ellipse
(eqs. 3.41a and 3.42a): exact for round footprints, an approximation for long ones.

Winkler (Johnson 1985, section 4.3): a bed of springs, in which the cells are independent.

p = k d, d the overlap of the undeformed surfaces. A layer of thickness h that cannot give way sideways
has k = E (1 - ν) / ((1 + ν) (1 - 2ν)) / h, which is E / h at ν = 0. Beds in series: 1/k = Σ 1/k_i.
It is right for layers thin against the contact; towards ν = 0.5 or thick layers, use the elastic layer.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from foretouch.errors import ContactError
from foretouch.simulation.contact.problem import (
    Command,
    ContactProblem,
    ContactSolution,
    Layer,
    no_contact,
    refuse_overload,
)
from foretouch.types import Float64

_REACH = 3  # cells on each side of first touch that its curvature is fitted on
_MIN_RATIO = 0.01  # smallest b / a that is resolved
_FAR_RADII = 1e4  # of the footprint, beyond which the series of the displacement is exact to double precision


@dataclass(frozen=True)
class _Paraboloid:
    """Gap A u² + B v² about (x0, y0); `axis` is the angle from x to u."""

    a: float
    b: float
    axis: float
    x0: float
    y0: float


def solve_hertz(problem: ContactProblem, command: Command) -> ContactSolution:
    """Press two bodies together as half-spaces that touch on a paraboloid.

    Raises:
        ContactError: If the gap about first touch is cut, flat or hollow, or too long for an ellipse; or if a
            layer is compressed beyond `max_strain`.
    """
    if command.idle:
        return no_contact(problem, command.depth_m or 0.0)
    shape = _fit(problem)
    ratio, k, d = _ellipse(shape.b / shape.a)
    modulus = problem.contact_modulus_pa
    if command.depth_m is None:
        force = float(command.force_n or 0.0)
        a = float(np.cbrt(3.0 * force * d / (2.0 * math.pi * modulus * shape.a)))
        depth = a**2 * shape.a * k / d
    else:
        depth = command.depth_m
        a = math.sqrt(depth * d / (shape.a * k))
        force = 2.0 * math.pi * modulus * shape.a * a**3 / (3.0 * d)
    b = ratio * a
    rho = _stretched_radius(problem, shape, a, b)
    pressure = _pressure(rho, force / problem.cell_m2)
    shares = np.array([modulus / layer.plane_modulus_pa for layer in problem.layers])
    displacement = shares[:, None, None] * _displacement(rho, depth)
    refuse_overload(problem, displacement, depth)
    return ContactSolution(pressure, displacement, force, math.pi * a * b, depth)


def _fit(problem: ContactProblem) -> _Paraboloid:
    """Least squares of a quadratic on the cells about the least gap."""
    n = problem.gap.shape[0]
    row, column = np.unravel_index(int(np.argmin(problem.gap)), problem.gap.shape)
    if not (_REACH <= row < n - _REACH and _REACH <= column < n - _REACH):
        raise ContactError(f"Hertz: first touch, cell ({row}, {column}) of {n}^2, is too close to the window's border")
    patch = problem.gap[row - _REACH : row + _REACH + 1, column - _REACH : column + _REACH + 1]
    if not np.isfinite(patch).all():
        raise ContactError("Hertz: an edge cuts the surface about first touch")
    _, gx, gy, gxx, gxy, gyy = _fit_matrix() @ patch.ravel() / problem.step_m ** np.array([0, 1, 1, 2, 2, 2])
    hessian = np.array([[gxx, gxy / 2.0], [gxy / 2.0, gyy]])
    (small, large), vectors = np.linalg.eigh(hessian)
    if small <= 0.0:
        raise ContactError(f"Hertz: the gap about first touch is flat or hollow, curvature {2.0 * small:.3g} 1/m")
    x0, y0 = -np.linalg.solve(2.0 * hessian, np.array([gx, gy]))
    middle, axis = (n - 1) / 2.0, math.atan2(vectors[1, 0], vectors[0, 0])
    x, y = ((float(cell) - middle) * problem.step_m + float(rest) for cell, rest in ((column, x0), (row, y0)))
    return _Paraboloid(float(small), float(large), axis, x, y)


@lru_cache(maxsize=1)
def _fit_matrix() -> Float64:
    """(6, cells): coefficients of 1, x, y, x², xy, y² in cells from the values of the patch."""
    offset = np.arange(-_REACH, _REACH + 1, dtype=np.float64)
    x, y = (v.ravel() for v in np.meshgrid(offset, offset))
    return np.asarray(np.linalg.pinv(np.column_stack([np.ones_like(x), x, y, x * x, x * y, y * y])), np.float64)


def _ellipse(curvature_ratio: float) -> tuple[float, float, float]:
    """b/a, K and D for B/A."""
    log_ratios, ratios, ks, ds = _ellipse_table()
    wanted = math.log(curvature_ratio)
    if wanted > log_ratios[-1]:
        raise ContactError(f"Hertz: curvatures differ by {curvature_ratio:.3g}, a line rather than an ellipse")
    ratio, k, d = (float(np.interp(wanted, log_ratios, column)) for column in (ratios, ks, ds))
    return ratio, k, d


@lru_cache(maxsize=1)
def _ellipse_table() -> Float64:
    """(4, n) float64: log B/A, b/a, K and D."""
    from scipy.special import ellipe, ellipkm1

    ratio = np.exp(np.linspace(-1e-4, math.log(_MIN_RATIO), 2000))  # b / a
    m = 1.0 - ratio**2  # e²
    k, e = ellipkm1(ratio**2), ellipe(m)
    log_b_over_a = np.log((e / ratio**2 - k) / (k - e))
    circle = (0.0, 1.0, math.pi / 2.0, math.pi / 4.0)  # where the formulas are 0 / 0
    return np.column_stack([circle, np.stack([log_b_over_a, ratio, k, (k - e) / m])])


def _stretched_radius(problem: ContactProblem, shape: _Paraboloid, a: float, b: float) -> Float64:
    """(N, N): √(u²/a² + v²/b²), 1 at the rim of the footprint."""
    offset = (np.arange(problem.gap.shape[0]) - (problem.gap.shape[0] - 1) / 2.0) * problem.step_m
    x, y = offset[None, :] - shape.x0, offset[:, None] - shape.y0
    u = math.cos(shape.axis) * x + math.sin(shape.axis) * y
    v = math.cos(shape.axis) * y - math.sin(shape.axis) * x
    return np.asarray(np.sqrt((u / a) ** 2 + (v / b) ** 2))


def _pressure(rho: Float64, total: float) -> Float64:
    """The half ellipsoid, its sum over the cells made `total`; a footprint between cells presses the nearest."""
    profile = np.sqrt(np.maximum(1.0 - rho**2, 0.0))
    weight = float(profile.sum())
    if weight == 0.0:
        profile = (rho == rho.min()).astype(np.float64)
        weight = float(profile.sum())
    return profile * (total / weight)


def _displacement(rho: Float64, depth: float) -> Float64:
    """Depth · (1 - ρ²/2) under pressure, eq. 3.42a beside it."""
    outer = np.clip(rho, 1.0, _FAR_RADII)
    beside = ((2.0 - outer**2) * np.arcsin(1.0 / outer) + np.sqrt(outer**2 - 1.0)) / math.pi
    if (rho > _FAR_RADII).any():  # where the terms, each about ρ, cancel: the first two terms of the series in 1/ρ
        far = 1.0 / np.maximum(rho, _FAR_RADII)
        beside = np.where(rho > _FAR_RADII, far * (4.0 / 3.0 + 2.0 / 15.0 * far**2) / math.pi, beside)
    return np.asarray(depth * np.where(rho <= 1.0, 1.0 - rho**2 / 2.0, beside))


_MAX_POISSON = 0.45  # beyond, the confined modulus depends more on ν than on the material


def bed_stiffness(layer: Layer) -> float:
    """Pressure per indentation of one layer [Pa/m].

    ν is capped at 0.45: an incompressible layer does not answer locally, and its bed would be rigid.

    Raises:
        ContactError: If the layer is a half-space, which has no bed.
    """
    if math.isinf(layer.thickness_m):
        raise ContactError("thickness_m: a half-space has no Winkler bed; use the elastic layer or Hertz")
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
