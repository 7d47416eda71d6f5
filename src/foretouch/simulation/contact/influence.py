# SPDX-License-Identifier: Apache-2.0
"""Influence coefficients: how far a pressed cell pushes the surface in, at every distance from it.

The half-space has Love's closed form for a uniformly pressed rectangle (Love 1929; Johnson 1985, eq. 3.25).
A bonded layer of thickness h differs from it by a smooth function of r/h, found from its answer to a
wave of pressure, wave number q, t = q h (Carbone & Mangialardi 2008, as after Johnson 1985, section 5.8):

    C(q) = 2 / (E* q) · M(t),
    M(t) = ((3 - 4ν) sinh 2t - 2t) / ((3 - 4ν) cosh 2t + 2t² + 5 - 12ν + 8ν²).

M -> 1 for t -> ∞ gives the half-space; C -> h / confined modulus for t -> 0 gives the Winkler bed.
The difference in space is the Hankel transform (1 / (π E* h)) ∫ (M(t) - 1) J0(t r/h) dt.
"""

import math
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from foretouch.errors import ContactError
from foretouch.simulation.contact.problem import Layer
from foretouch.types import Float64

Complex128 = npt.NDArray[np.complex128]

_FAR = 12.0  # r/h beyond which the layer's own answer is below 1e-8: only the half-space's tail is to be removed
_TABLE = 2401
_WAVES = 30.0  # t beyond which M - 1 is below 1e-20
_GAUSS = 3  # points a side that average the smooth part over a cell
_CACHED = 64  # spectra kept, 130 kB each at N = 64


def layer_transfer(t: npt.ArrayLike, poisson: float) -> Float64:
    """M(t) of a bonded layer: its compliance over that of a half-space, for t = q h at least 0."""
    t = np.asarray(t, np.float64)
    decay = np.exp(-2.0 * t)  # numerator and denominator times 2 exp(-2t): no overflow at large t
    a = 3.0 - 4.0 * poisson
    constant = 5.0 - 12.0 * poisson + 8.0 * poisson**2
    numerator = a * (1.0 - decay**2) - 4.0 * t * decay
    denominator = a * (1.0 + decay**2) + 2.0 * decay * (2.0 * t**2 + constant)
    return np.asarray(numerator / denominator, np.float64)


def love_influence(x: Float64, y: Float64, step_m: float, plane_modulus_pa: float) -> Float64:
    """Displacement of a half-space at (x, y) from its centre, by a square cell under 1 Pa [m/Pa].

    Args:
        x: Offset along the rows [m].
        y: Offset along the columns, broadcastable with `x` [m].
        step_m: Side of the cell [m].
        plane_modulus_pa: E / (1 - ν²) [Pa].
    """
    left, right = x - step_m / 2.0, x + step_m / 2.0
    low, high = y - step_m / 2.0, y + step_m / 2.0
    return (_corner(right, high) + _corner(left, low) - _corner(right, low) - _corner(left, high)) / (
        math.pi * plane_modulus_pa
    )


def layer_influence(layer: Layer, n: int, step_m: float) -> Float64:
    """(n, n) float64 [m/Pa]: displacement at cell (i, j) by cell (0, 0) under 1 Pa.

    Raises:
        ContactError: If the layer is thinner than half a cell, where the smooth part cannot be averaged.
    """
    offset = step_m * np.arange(n, dtype=np.float64)
    x, y = offset[None, :], offset[:, None]
    half_space = love_influence(x, y, step_m, layer.plane_modulus_pa)
    if math.isinf(layer.thickness_m):
        return half_space
    if layer.thickness_m < step_m / 2.0:
        raise ContactError(
            f"thickness_m: {layer.thickness_m:g} is less than half a cell, {step_m / 2.0:g} m: use the Winkler level"
        )
    nodes, weights = np.polynomial.legendre.leggauss(_GAUSS)
    smooth = np.zeros((n, n))
    for dx, wx in zip(nodes * step_m / 2.0, weights / 2.0, strict=True):
        for dy, wy in zip(nodes * step_m / 2.0, weights / 2.0, strict=True):
            smooth += wx * wy * _smooth_part(np.hypot(x + dx, y + dy) / layer.thickness_m, layer.poisson)
    return half_space + smooth * step_m**2 / (math.pi * layer.plane_modulus_pa * layer.thickness_m)


@lru_cache(maxsize=_CACHED)
def influence_spectrum(layer: Layer, n: int, step_m: float) -> Complex128:
    """(2n, n + 1) complex128: the spectrum that turns an n x n pressure into displacement without wrapping.

    The coefficients fill a grid of twice the size, so that the cyclic convolution of the padded pressure
    is the plain one (DC-FFT; Liu, Wang & Liu 2000). Kept for the latest layers and grids; do not write to it.
    """
    quarter = layer_influence(layer, n, step_m)
    full = np.zeros((2 * n, 2 * n))
    index = np.minimum(np.arange(2 * n), np.arange(2 * n, 0, -1)) % (2 * n)
    inside = np.flatnonzero(index < n)
    full[np.ix_(inside, inside)] = quarter[np.ix_(index[inside], index[inside])]
    spectrum: Complex128 = np.fft.rfft2(full)
    spectrum.setflags(write=False)
    return spectrum


def convolve(pressure: Float64, spectrum: Complex128) -> Float64:
    """Displacement [m] of a pressure (N, N) [Pa], by the spectrum of `influence_spectrum`.

    By axis, so that rows of zeros are not transformed on the way in, nor unused ones on the way out.

    Args:
        pressure: (N, N) float64 [Pa].
        spectrum: (2N, N + 1), or (L, 2N, N + 1) for one layer each.

    Returns:
        (N, N) or (L, N, N) float64 [m].
    """
    n = pressure.shape[0]
    waves = np.fft.fft(np.fft.rfft(pressure, 2 * n, axis=1), 2 * n, axis=0) * spectrum
    columns = np.fft.ifft(waves, axis=-2)[..., :n, :]
    return np.asarray(np.fft.irfft(columns, 2 * n, axis=-1)[..., :n])


def _corner(x: Float64, y: Float64) -> Float64:
    return x * np.arcsinh(y / np.abs(x)) + y * np.arcsinh(x / np.abs(y))  # never 0: corners lie between cells


def _smooth_part(rho: Float64, poisson: float) -> Float64:
    """∫ (M(t) - 1) J0(t ρ) dt; beyond the table M's own part is nil and -1/ρ remains."""
    grid, values = _smooth_table(poisson)
    near = np.interp(rho, grid, values)
    return np.where(rho > _FAR, -1.0 / np.maximum(rho, _FAR), near)


@lru_cache(maxsize=16)
def _smooth_table(poisson: float) -> tuple[Float64, Any]:
    from scipy.special import j0

    nodes, weights = np.polynomial.legendre.leggauss(400)
    t = _WAVES * (nodes + 1.0) / 2.0
    integrand = weights * _WAVES / 2.0 * (layer_transfer(t, poisson) - 1.0)
    rho = np.linspace(0.0, _FAR, _TABLE)
    return rho, j0(np.outer(rho, t)) @ integrand
