# SPDX-License-Identifier: Apache-2.0
"""Contact of elastic layers or half-spaces: influence coefficients and constrained conjugate gradients.

Influence coefficients state how far a pressed cell pushes the surface in, at every distance from it. The half-space has
Love's closed form for a uniformly pressed rectangle (Love 1929; Johnson 1985, eq. 3.25). A bonded layer of thickness h
differs from it by a smooth function of r/h, found from its answer to a wave of pressure, wave number q, t = q h
(Carbone & Mangialardi 2008, as after Johnson 1985, section 5.8):

    C(q) = 2 / (E* q) · M(t),
    M(t) = ((3 - 4ν) sinh 2t - 2t) / ((3 - 4ν) cosh 2t + 2t² + 5 - 12ν + 8ν²).

M -> 1 for t -> ∞ gives the half-space; C -> h / confined modulus for t -> 0 gives the Winkler bed.
The difference in space is the Hankel transform (1 / (π E* h)) ∫ (M(t) - 1) J0(t r/h) dt.

The pressure follows by constrained conjugate gradients (Polonsky & Keer 1999). The start of the iteration is guessed in
closed form. A thick layer answers like a half-space, whose mean stiffness under a footprint of radius a is
4√2 / (3π) E* / a (from Hertz); a thin one like its bed of springs. The two are added. Between the limits
the footprint shrinks from all cells that overlap (bed) to half that depth (Hertz), and the profile
turns from linear in the overlap to its square root.

The descent (`kernels/layer.c`) minimises under the bound p >= 0 (their steps 1 to 8). With K the influence of pressure on displacement,
the pressure solves

    p >= 0,   r = K p + g - d >= 0,   p r = 0,

at a given depth d, or at the depth for which Σ p · cell is the given force. Products with K are
convolutions by FFT. The descent runs on the part of the window that the footprint is
expected in; the result is then checked on the whole window, and solved there if it does not hold.
"""

import math
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from foretouch.errors import ContactError, ConvergenceError
from foretouch.kernels import Kernel, struct
from foretouch.types import Float64
from foretouch_lab.simulation.contact.problem import (
    Command,
    ContactProblem,
    ContactSolution,
    ElasticLayer,
    bed_stiffness,
    no_contact,
    refuse_overload,
)

Complex128 = npt.NDArray[np.complex128]

_FAR = 12.0  # r/h beyond which the layer's own answer is below 1e-8: only the half-space's tail is to be removed
_TABLE = 2401
_WAVES = 30.0  # t beyond which M - 1 is below 1e-20
_CACHED = 64  # spectra kept, 130 kB each at N = 64

_layer_descent = Kernel("layer_descent")


def _layer_transfer(t: npt.ArrayLike, poisson: float) -> Float64:
    """M(t) of a bonded layer: its compliance over the compliance of a half-space, for t = q h at least 0."""
    t = np.asarray(t, np.float64)
    decay = np.exp(-2.0 * t)  # numerator and denominator times 2 exp(-2t): no overflow at large t
    a = 3.0 - 4.0 * poisson
    constant = 5.0 - 12.0 * poisson + 8.0 * poisson**2
    numerator = a * (1.0 - decay**2) - 4.0 * t * decay
    return np.asarray(numerator / (a * (1.0 + decay**2) + 2.0 * decay * (2.0 * t**2 + constant)), np.float64)


def _love_influence(x: Float64, y: Float64, step_m: float, plane_modulus_pa: float) -> Float64:
    """Return the displacement of a half-space at (x, y) [m] from its centre, by a square cell under 1 Pa [m/Pa]."""
    left, right = x - step_m / 2.0, x + step_m / 2.0
    low, high = y - step_m / 2.0, y + step_m / 2.0
    return (_corner(right, high) + _corner(left, low) - _corner(right, low) - _corner(left, high)) / (
        math.pi * plane_modulus_pa
    )


def _layer_influence(layer: ElasticLayer, n: int, step_m: float) -> Float64:
    """Return (n, n) float64 [m/Pa]: displacement at cell (i, j) by cell (0, 0) under 1 Pa."""
    offset = step_m * np.arange(n, dtype=np.float64)
    x, y = offset[None, :], offset[:, None]
    half_space = _love_influence(x, y, step_m, layer.plane_modulus_pa)
    if math.isinf(layer.thickness_m):
        return half_space
    if layer.thickness_m < step_m / 2.0:
        raise ContactError(  # the smooth part cannot be averaged over a cell
            f"thickness_m: {layer.thickness_m:g} is less than half a cell, {step_m / 2.0:g} m: use the Winkler level"
        )
    nodes, weights = np.polynomial.legendre.leggauss(3)  # a side, to average the smooth part over a cell
    smooth = np.zeros((n, n))
    for dx, wx in zip(nodes * step_m / 2.0, weights / 2.0, strict=True):
        for dy, wy in zip(nodes * step_m / 2.0, weights / 2.0, strict=True):
            smooth += wx * wy * _smooth_part(np.hypot(x + dx, y + dy) / layer.thickness_m, layer.poisson)
    return half_space + smooth * step_m**2 / (math.pi * layer.plane_modulus_pa * layer.thickness_m)


@lru_cache(maxsize=_CACHED)
def _influence_spectrum(layer: ElasticLayer, n: int, step_m: float) -> Complex128:
    """Return (2n, n + 1) complex128: the spectrum that turns an n x n pressure into displacement without wrapping.

    The coefficients fill a grid of twice the size, so that the cyclic convolution of the padded pressure
    is the plain one (DC-FFT; Liu, Wang & Liu 2000). Kept for the latest layers and grids; do not write to it.
    """
    quarter = _layer_influence(layer, n, step_m)
    full = np.zeros((2 * n, 2 * n))
    index = np.minimum(np.arange(2 * n), np.arange(2 * n, 0, -1)) % (2 * n)
    inside = np.flatnonzero(index < n)
    full[np.ix_(inside, inside)] = quarter[np.ix_(index[inside], index[inside])]
    spectrum: Complex128 = np.fft.rfft2(full)
    spectrum.setflags(write=False)
    return spectrum


def _convolve(pressure: Float64, spectrum: Complex128) -> Float64:
    """Return (L, N, N) float64 [m], displacement by a pressure (N, N) [Pa], from `_influence_spectrum` (L, 2N, N + 1) of L layers.

    By axis, so that rows of zeros are not transformed on the way in, nor unused ones on the way out.
    """
    n = pressure.shape[0]
    waves = np.fft.fft(np.fft.rfft(pressure, 2 * n, axis=1), 2 * n, axis=0) * spectrum
    return np.asarray(np.fft.irfft(np.fft.ifft(waves, axis=-2)[..., :n, :], 2 * n, axis=-1)[..., :n])


def _corner(x: Float64, y: Float64) -> Float64:
    return x * np.arcsinh(y / np.abs(x)) + y * np.arcsinh(x / np.abs(y))  # never 0: corners lie between cells


def _smooth_part(rho: Float64, poisson: float) -> Float64:
    """∫ (M(t) - 1) J0(t ρ) dt; beyond the table M's own part is nil and -1/ρ remains."""
    grid, values = _smooth_table(poisson)
    return np.where(rho > _FAR, -1.0 / np.maximum(rho, _FAR), np.interp(rho, grid, values))


@lru_cache(maxsize=16)
def _smooth_table(poisson: float) -> tuple[Float64, Any]:
    from scipy.special import j0

    nodes, weights = np.polynomial.legendre.leggauss(400)
    t = _WAVES * (nodes + 1.0) / 2.0
    integrand = weights * _WAVES / 2.0 * (_layer_transfer(t, poisson) - 1.0)
    rho = np.linspace(0.0, _FAR, _TABLE)
    return rho, j0(np.outer(rho, t)) @ integrand


_HERTZ = 4.0 * math.sqrt(2.0) / (3.0 * math.pi)
_ABSENT_M = 1e9  # stands for an infinite gap: finite, so that 0 pressure times it is 0, and out of reach
_SIZES = (8, 12, 16, 20, 24, 32, 40, 48, 64, 80, 96, 128)  # few, so that the spectra kept suffice
_MARGIN = 2  # cells around the expected footprint
_OVERLAP = 2e-2  # of the depth: how far the surfaces may still overlap before it is solved again on the window

TOLERANCE = 1e-4  # change of the pressure in the last step over the force
MAX_ITERATIONS = 300  # before a contact is refused


def solve_layer(problem: ContactProblem, command: Command) -> ContactSolution:
    """Press two bodies together, each cell influencing all others.

    Raises:
        ConvergenceError: If it does not converge in `MAX_ITERATIONS`.
        ContactError: If a layer is compressed too far.
    """
    if command.idle:
        return no_contact(problem, command.depth_m or 0.0)
    gap = np.minimum(problem.gap, _ABSENT_M)
    guess = _expected_pressure(problem, command)
    box = _box_around(guess)  # only the expected footprint and its margin may carry pressure at first
    pressure = np.zeros_like(gap)
    pressure[box], depth, iterations, residual = _descend(problem, command, gap[box], guess[box])
    displacement = _displacements(problem, pressure)
    overlap = depth - float((displacement.sum(axis=0) + gap).min())  # how far the surfaces still overlap anywhere
    if residual >= TOLERANCE or overlap > _OVERLAP * abs(depth):
        # The guess misled: from even pressure wherever both surfaces exist, which is slower and sure.
        even = np.isfinite(problem.gap) * (problem.contact_modulus_pa * 1e-3)
        pressure, depth, more, residual = _descend(problem, command, gap, even)
        if residual >= TOLERANCE:
            raise ConvergenceError(
                f"elastic layer: no convergence after {iterations + more} iterations on {gap.shape[0]}^2 cells, "
                f"{np.count_nonzero(pressure)} of them in contact: residual {residual:.3g}, tolerance {TOLERANCE:g}"
            )
        displacement = _displacements(problem, pressure)
    refuse_overload(problem, displacement, depth)
    force, cells = float(pressure.sum()) * problem.cell_m2, int(np.count_nonzero(pressure))
    return ContactSolution(pressure, displacement, force, cells * problem.cell_m2, depth)


def _box_around(pressure: Float64) -> tuple[slice, slice]:
    """Return the smallest square of a few sizes that holds all pressed cells and a margin on each side."""
    n = pressure.shape[0]
    spans = [np.flatnonzero(pressure.any(axis=axis)) for axis in (1, 0)]
    needed = max(int(span[-1] - span[0]) for span in spans) + 1 + 2 * _MARGIN
    size = min(next((s for s in _SIZES if s >= needed), n), n)
    row, column = (min(max((int(s[0] + s[-1]) + 1 - size) // 2, 0), n - size) for s in spans)
    return slice(row, row + size), slice(column, column + size)


def _expected_pressure(problem: ContactProblem, command: Command) -> Float64:
    """Return (N, N) float64 [Pa]: at least one cell is pressed; all pressed ones have a finite gap."""
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
    overlap = np.maximum(1.0 - problem.gap / (depth * (1.0 + bed_share) / 2.0), 0.0)
    shape: Float64 = overlap ** ((1.0 + bed_share) / 2.0)
    mean = float(stiffness[k]) * (depth - float(gaps[: k + 1].mean())) * (k + 1)
    return np.asarray(shape * (mean / float(shape.sum())))


def _stiffness(problem: ContactProblem, radius: Float64) -> Float64:
    compliance = np.zeros_like(radius)
    for layer in problem.layers:
        bed = 0.0 if math.isinf(layer.thickness_m) else bed_stiffness(layer)
        compliance += 1.0 / (bed + _HERTZ * layer.plane_modulus_pa / radius)
    return np.asarray(1.0 / compliance)


def _descend(
    problem: ContactProblem, command: Command, gap: Float64, start: Float64
) -> tuple[Float64, float, int, float]:
    """Step until the tolerance is met or the iterations are spent: (N, N) pressure [Pa], depth [m], iterations and residual."""
    gap, start = np.ascontiguousarray(gap), np.ascontiguousarray(start)  # for the compiled function
    spectrum = _spectra(problem.layers, gap.shape[0], problem.step_m)[1]
    if command.force_n is None:
        pressure, given = start.copy(), float(command.depth_m or 0.0)
    else:
        given = command.force_n / problem.cell_m2
        pressure = np.ascontiguousarray(start * (given / float(start.sum())))
    how = struct(
        "Descent",
        given=given,
        by_force=int(command.force_n is not None),
        safe_length=1.0 / float(np.abs(spectrum).max()),  # below 2 / (largest eigenvalue of K)
        tolerance=TOLERANCE,
        most=MAX_ITERATIONS,
    )
    end = np.zeros(4)
    _layer_descent(gap, spectrum.view(np.float64), gap.shape[0], how, pressure, end)
    if not end[3]:
        raise MemoryError("layer_descent")
    return pressure, float(end[0]), int(end[1]), float(end[2])


@lru_cache(maxsize=_CACHED)
def _spectra(layers: tuple[ElasticLayer, ...], n: int, step_m: float) -> tuple[Complex128, Complex128]:
    """Return (L, 2n, n + 1) of each layer, and their sum; do not write to them."""
    each = np.stack([_influence_spectrum(layer, n, step_m) for layer in layers])
    return each, each.sum(axis=0)


def _displacements(problem: ContactProblem, pressure: Float64) -> Float64:
    return _convolve(pressure, _spectra(problem.layers, pressure.shape[0], problem.step_m)[0])
