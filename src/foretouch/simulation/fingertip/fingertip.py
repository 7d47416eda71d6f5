# SPDX-License-Identifier: Apache-2.0
"""One fingertip: rest level and gain (which vary with inflation, wear and make), the PDC channel and the electrodes.

**PDC**: how the static pressure of the liquid (PDC) follows the contact.

The contact pushes liquid aside until, near 2 N, the skin meets the core and the core takes the load (BioTac product
manual). With u the skin's displacement, b the depth at which skin meets core and n the contact's normal:

    V = Σ_cells min(u, b) · cell,          PDC = rest + gain · span · c · tanh(V / V_sat)

c = (n · pad)^k, the share of liquid pressure where the skin is free: its rim is clamped to the nail side.
The electrodes do not enter: where the contact lies decides them, and hardly V.

**Electrodes**: how the 24 electrodes respond to the displacement of the skin. The liquid between skin and core
conducts; where the skin comes closer, the path narrows and the impedance Z rises, where liquid is pushed to, it falls
(BioTac product manual, Syntouch). Here:

    s_e = Σ_cells w_e u (n · n_e)+ - V / A          how much closer the skin is at electrode e [m]
    Z_e = Z_rest,e · exp(gain_e · s_e / thinning)   a layer that thins ever more slowly
    E_e = 4095 / (1 + Z_e / 10 kOhm)                counts, the inverse of `foretouch.tactile.to_kohm`

with u the skin's displacement, w_e a Gaussian about the electrode's position on the skin, n the contact's
normal, n_e the electrode's, and V / A the even bulge by which the displaced liquid V lifts the skin's area A.

`read_contact` turns a solved contact into the readings of the fingertip.
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from foretouch.config import Settings, setting
from foretouch.errors import ConfigError, ContactError, TactileError
from foretouch.simulation.contact.pad import ContactFrame, PadConfig, PadWindow
from foretouch.simulation.contact.problem import ContactSolution
from foretouch.tactile import FULL_SCALE, electrode_normals, electrode_positions, to_kohm
from foretouch.types import ELECTRODES, Float64

_LOWEST_REST: Final = 500.0
_HIGHEST_REST: Final = 4000.0


@dataclass(frozen=True, kw_only=True)
class FingerConfig(Settings):
    """Rest and gain of a kind of fingertip; a spread of 0 makes all its electrodes equal."""

    pdc_rest: float = setting(1676.0, "PDC without contact", unit="counts", minimum=1.0, maximum=4094.0)
    pdc_gain: float = setting(1.0, "Factor on the rise of PDC", minimum=0.0, maximum=1e3)
    electrode_rest: float = setting(3450.0, "Electrodes without contact", unit="counts", minimum=500.0, maximum=4000.0)
    electrode_rest_spread: float = setting(
        70.0, "Standard deviation of that from electrode to electrode", unit="counts", minimum=0.0, maximum=1e4
    )
    electrode_gain: float = setting(1.0, "Factor on the approach of the skin", minimum=0.0, maximum=1e3)
    electrode_gain_spread: float = setting(
        0.1, "Standard deviation of its logarithm from electrode to electrode", minimum=0.0, maximum=10.0
    )


MIDDLE_FINGER: Final = FingerConfig()
"""PDC as real ones at rest; electrodes so that in grasps their 95th percentile is near that of real ones, 3600."""

THUMB: Final = FingerConfig(pdc_rest=2779.0, electrode_rest=3150.0)
"""The same for a thumb, whose electrodes reach 3350: PDC is higher, electrodes are lower."""


@dataclass(frozen=True, eq=False)
class Finger:
    """One fingertip."""

    pdc_rest: float  # PDC without contact [counts]
    pdc_gain: float  # factor on its rise
    electrode_rest: Float64  # (24,) float64 [counts]
    electrode_gain: Float64  # (24,) float64


def draw_finger(config: FingerConfig, rng: np.random.Generator) -> Finger:
    """One fingertip of a kind; the same random numbers are drawn for any spread."""
    rest = config.electrode_rest + config.electrode_rest_spread * rng.standard_normal(ELECTRODES)
    gain = config.electrode_gain * np.exp(config.electrode_gain_spread * rng.standard_normal(ELECTRODES))
    return Finger(config.pdc_rest, config.pdc_gain, np.clip(rest, _LOWEST_REST, _HIGHEST_REST), gain)


@dataclass(frozen=True, kw_only=True)
class FluidConfig(Settings):
    """How the liquid answers."""

    bottoming_m: float = setting(
        3e-4, "Displacement at which the skin meets the core", unit="m", minimum=1e-6, maximum=1.0
    )
    saturation_m3: float = setting(
        8.5e-10, "Volume at which the pressure levels off", unit="m^3", minimum=1e-12, maximum=1.0
    )
    span_counts: float = setting(220.0, "Rise of PDC where it levels off", unit="counts", minimum=0.0, maximum=1e6)
    rim_power: float = setting(
        2.0, "How fast the answer falls from the pad's middle to its rim", minimum=0.0, maximum=100.0
    )


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


_REFERENCE_KOHM: Final = 10.0
_MAX_EXPONENT: Final = 50.0  # beyond, E rounds to 0 from any rest


@dataclass(frozen=True, kw_only=True)
class ElectrodeConfig(Settings):
    """How far an electrode looks and how strongly it answers."""

    kernel_m: float = setting(
        0.003, "Standard deviation of an electrode's field on the skin", unit="m", minimum=1e-4, maximum=1.0
    )
    thinning_m: float = setting(
        3.1e-5, "Approach of the skin that raises the impedance by a factor e", unit="m", minimum=1e-6, maximum=1.0
    )
    bulge_area_m2: float = setting(
        2.3e-4, "Area of skin that displaced liquid lifts evenly", unit="m^2", minimum=1e-6, maximum=1.0
    )


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


_LOWEST_ELECTRODE: Final = 0


@dataclass(frozen=True, kw_only=True)
class FingertipConfig(Settings):
    """How a fingertip turns contact into counts.

    Raises:
        ConfigError: If the lowest PDC is not below the highest.
    """

    electrodes: ElectrodeConfig = ElectrodeConfig()
    fluid: FluidConfig = FluidConfig()
    pdc_lowest: int = setting(0, "Lowest PDC the converter gives", unit="counts", minimum=0, maximum=FULL_SCALE)
    pdc_highest: int = setting(
        FULL_SCALE, "Highest PDC the converter gives", unit="counts", minimum=0, maximum=FULL_SCALE
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.pdc_lowest >= self.pdc_highest:
            raise ConfigError(
                f"FingertipConfig.pdc_lowest: {self.pdc_lowest} is not below pdc_highest {self.pdc_highest}"
            )


@dataclass(frozen=True, eq=False)
class Reading:
    """One fingertip before noise and rounding."""

    pdc: float  # static pressure [counts]
    electrodes: Float64  # (24,) float64 [counts]


def rest_reading(finger: Finger) -> Reading:
    """What the fingertip reads without contact."""
    return Reading(finger.pdc_rest, finger.electrode_rest.copy())


def read_contact(
    config: FingertipConfig, pad: PadConfig, finger: Finger, window: PadWindow, solution: ContactSolution
) -> Reading:
    """What the fingertip reads in contact; without force, its rest to the bit.

    Args:
        config: How contact becomes counts.
        pad: Shape of the pad and of the window.
        finger: Its rest and gain.
        window: Where it is touched.
        solution: Of the contact; the first of its layers is the skin.

    Raises:
        ContactError: If the solution is on another grid.
    """
    if solution.force_n == 0.0:
        return rest_reading(finger)
    skin = solution.displacement[0]
    volume = displaced_volume(config.fluid, skin, pad.step_m**2)
    weights = electrode_weights(config.electrodes, pad, window.frame, window.points)
    approach = skin_approach(config.electrodes, weights, skin, volume)
    electrodes = electrode_counts(config.electrodes, approach, finger.electrode_rest, finger.electrode_gain)
    return Reading(pdc_counts(config.fluid, window.frame, volume, finger.pdc_rest, finger.pdc_gain), electrodes)


def quantise(
    config: FingertipConfig, pdc: npt.ArrayLike, electrodes: npt.ArrayLike
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Round and clip as the 12-bit converter does: electrodes to 0..4095, PDC to its range.

    Args:
        config: The range of PDC.
        pdc: (...) counts.
        electrodes: (..., 24) counts.

    Raises:
        TactileError: If a value is not finite: a converter has no such count.
    """
    rounded = []
    limits = ((pdc, config.pdc_lowest, config.pdc_highest), (electrodes, _LOWEST_ELECTRODE, FULL_SCALE))
    for name, (values, low, high) in zip(("pdc", "electrodes"), limits, strict=True):
        counts = np.asarray(values, np.float64)
        if not np.isfinite(counts).all():
            raise TactileError(f"{name}: {np.count_nonzero(~np.isfinite(counts))} values are not finite")
        rounded.append(np.clip(np.rint(counts), low, high).astype(np.int64))
    return rounded[0], rounded[1]
