# SPDX-License-Identifier: Apache-2.0
"""How the static pressure of the liquid (PDC) follows the contact.

The contact pushes liquid aside until, near 2 N, the skin meets the core and the core takes the load (BioTac product
manual). With u the skin's displacement, b the depth at which skin meets core and n the contact's normal:

    V = Σ_cells min(u, b) · cell,          PDC = rest + gain · span · c · tanh(V / V_sat)

c = (n · pad)^k, the share of liquid pressure where the skin is not held: its rim is clamped to the nail side.
The electrodes do not enter: where the contact lies decides them, and hardly V.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from foretouch.config import Settings, setting
from foretouch.simulation.contact.pad import ContactFrame
from foretouch.types import Float64

__all__ = ["FluidConfig", "displaced_volume", "pdc_counts"]


@dataclass(frozen=True, kw_only=True)
class FluidConfig(Settings):
    """How the liquid answers."""

    bottoming_m: float = setting(3e-4, "Displacement at which the skin meets the core", unit="m", minimum=1e-6)
    saturation_m3: float = setting(8.5e-10, "Volume at which the pressure levels off", unit="m^3", minimum=1e-12)
    span_counts: float = setting(220.0, "Rise of PDC where it levels off", unit="counts", minimum=0.0)
    rim_power: float = setting(2.0, "How fast the answer falls from the pad's middle to its rim", minimum=0.0)


def displaced_volume(config: FluidConfig, displacement: Float64, cell_m2: float) -> float:
    """Liquid pushed aside by the contact [m³].

    Args:
        config: The liquid.
        displacement: (N, N) float64 [m], of the skin; a rise beside the contact takes liquid up.
        cell_m2: Area of a cell [m²].
    """
    return max(float(np.minimum(displacement, config.bottoming_m).sum()) * cell_m2, 0.0)


def pdc_counts(config: FluidConfig, frame: ContactFrame, volume_m3: float, rest: float, gain: float = 1.0) -> float:
    """PDC in counts, not yet rounded.

    Args:
        config: The liquid.
        frame: Where the pad is touched.
        volume_m3: Of `displaced_volume`.
        rest: PDC without contact [counts].
        gain: Of the finger.
    """
    facing = math.pow(max(-float(frame.rotation[2, 2]), 0.0), config.rim_power)
    rise = config.span_counts * facing * math.tanh(volume_m3 / config.saturation_m3)
    return rest + gain * rise
