# SPDX-License-Identifier: Apache-2.0
"""How the 24 electrodes see the skin move.

The liquid between skin and core conducts; where the skin comes closer, the path narrows and the
impedance Z rises, where liquid is pushed to, it falls (BioTac product manual, Syntouch). Here:

    s_e = Σ_cells w_e u (n · n_e)+ - V / A          how much closer the skin is at electrode e [m]
    Z_e = Z_rest,e · exp(gain_e · s_e / thinning)   a layer that thins ever more slowly
    E_e = 4095 / (1 + Z_e / 10 kOhm)                counts, the inverse of `foretouch.tactile.to_kohm`

with u the skin's displacement, w_e a Gaussian about the electrode's place on the skin, n the contact's
normal, n_e the electrode's, and V / A the even bulge by which the displaced liquid V lifts the skin's area A.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from foretouch.config import Settings, setting
from foretouch.errors import ContactError
from foretouch.simulation.contact.pad import ContactFrame, PadConfig
from foretouch.tactile import FULL_SCALE, electrode_normals, electrode_positions, to_kohm
from foretouch.types import Float64

__all__ = ["ElectrodeConfig", "counts_at", "electrode_counts", "electrode_weights", "skin_approach"]

_REFERENCE_KOHM: Final = 10.0
_MAX_EXPONENT: Final = 50.0  # beyond, E rounds to 0 from any rest


@dataclass(frozen=True, kw_only=True)
class ElectrodeConfig(Settings):
    """How far an electrode looks and how strongly it answers."""

    kernel_m: float = setting(0.003, "Standard deviation of an electrode's field on the skin", unit="m", minimum=1e-4)
    thinning_m: float = setting(
        3.1e-5, "Approach of the skin that raises the impedance by a factor e", unit="m", minimum=1e-6
    )
    bulge_area_m2: float = setting(2.3e-4, "Area of skin that displaced liquid lifts evenly", unit="m^2", minimum=1e-6)


def electrode_weights(config: ElectrodeConfig, pad: PadConfig, frame: ContactFrame, skin_points: Float64) -> Float64:
    """What each cell of a contact counts for at each electrode.

    Args:
        config: The electrodes.
        pad: Shape of the pad.
        frame: Where it is touched.
        skin_points: (N, N, 3) float64 [m], the cells on the skin, fingertip frame; not finite beside the pad.

    Returns:
        (24, N * N) float64; over a plane of cells the weights of an electrode facing it sum to 1.
    """
    points = skin_points.reshape(-1, 3)
    normals = electrode_normals()
    places = electrode_positions() + pad.layer_m * normals
    on_skin = np.isfinite(points.sum(axis=1))
    points = np.where(on_skin[:, None], points, 0.0)
    # |p - e|² = |p|² - 2 p·e + |e|², so that the bulk of the work is one product of matrices
    squares = np.einsum("ij,ij->i", points, points) - 2.0 * places @ points.T
    squares += np.einsum("ij,ij->i", places, places)[:, None]
    scale = pad.step_m**2 / (2.0 * math.pi * config.kernel_m**2)
    facing = np.maximum(normals @ frame.rotation[:, 2], 0.0)
    weights: Float64 = np.exp(squares * (-0.5 / config.kernel_m**2))
    weights *= (scale * facing)[:, None]
    weights *= on_skin
    return weights


def skin_approach(config: ElectrodeConfig, weights: Float64, displacement: Float64, volume_m3: float) -> Float64:
    """(24,) float64 [m]: how much closer the skin is to each electrode; negative where it bulges.

    Args:
        config: The electrodes.
        weights: (24, N * N) of `electrode_weights`.
        displacement: (N, N) float64 [m], of the skin.
        volume_m3: Liquid pushed aside by the contact (`fluid.displaced_volume`).

    Raises:
        ContactError: If the shapes do not fit.
    """
    if weights.shape[1] != displacement.size:
        raise ContactError(f"displacement: {displacement.size} cells, but weights for {weights.shape[1]}")
    return np.asarray(weights @ displacement.ravel() - volume_m3 / config.bulge_area_m2)


def electrode_counts(config: ElectrodeConfig, approach: Float64, rest: Float64, gain: Float64 | float = 1.0) -> Float64:
    """(..., 24) float64 counts, not yet rounded, in (0, 4095).

    Args:
        config: The electrodes.
        approach: (..., 24) float64 [m] of `skin_approach`.
        rest: (24,) counts without contact, above 0 and below 4095.
        gain: Of each electrode, or of all.

    Raises:
        TactileError: If a rest is outside (0, 4095].
    """
    exponent = np.clip(gain * approach / config.thinning_m, -_MAX_EXPONENT, _MAX_EXPONENT)
    return counts_at(to_kohm(rest) * np.exp(exponent))


def counts_at(impedance_kohm: Float64) -> Float64:
    """E = 4095 / (1 + Z / 10 kOhm), counts not rounded."""
    return np.asarray(FULL_SCALE / (1.0 + impedance_kohm / _REFERENCE_KOHM))
