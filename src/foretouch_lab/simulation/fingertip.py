# SPDX-License-Identifier: Apache-2.0
"""The BioTac SP fingertip: from contact to the counts of the PDC channel and the electrodes.

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

from foretouch.config import Settings, setting
from foretouch.errors import TactileError
from foretouch.tactile import BIOTAC_SP, ELECTRODES, FULL_SCALE, to_kohm
from foretouch.types import Float64, Int64
from foretouch_lab.simulation.contact.pad import ContactFrame, PadConfig, PadWindow
from foretouch_lab.simulation.contact.problem import ContactSolution

# The liquid.
BOTTOMING_M: Final = 3e-4  # displacement b at which the skin meets the core
SATURATION_M3: Final = 8.5e-10  # volume V_sat at which the pressure levels off
PDC_SPAN: Final = 220.0  # rise of PDC where it levels off [counts]
RIM_POWER: Final = 2.0  # k: how fast the response falls from the middle of the pad to its rim

# The electrodes.
KERNEL_M: Final = 0.003  # standard deviation of an electrode's field on the skin
THINNING_M: Final = 3.1e-5  # approach of the skin that raises the impedance by a factor e
BULGE_AREA_M2: Final = 2.3e-4  # area A of the skin that displaced liquid lifts evenly
REST_SPREAD: Final = 70.0  # standard deviation of the rest level from electrode to electrode [counts]
GAIN_SPREAD: Final = 0.1  # standard deviation of the logarithm of the gain from electrode to electrode
_REST_LIMITS: Final = (500.0, 4000.0)  # of an electrode [counts]

_REFERENCE_KOHM: Final = 10.0
_MAX_EXPONENT: Final = 50.0  # beyond, E rounds to 0 from any rest


@dataclass(frozen=True, kw_only=True)
class SimulatedFingerConfig(Settings):
    """Rest levels of a fingertip, which vary with inflation, wear and make.

    The defaults are those of a middle finger: PDC as real ones at rest; electrodes so that in grasps their 95th
    percentile is near that of real ones, 3600.
    """

    pdc_rest: float = setting(1676.0, "PDC without contact", unit="counts", bounds=(1.0, 4094.0))
    electrode_rest: float = setting(
        3450.0, "Mean of the electrodes without contact", unit="counts", bounds=(500.0, 4000.0)
    )
    pdc_span: float = setting(PDC_SPAN, "Rise of PDC where it levels off", unit="counts", bounds=(1.0, 4094.0))


@dataclass(frozen=True, kw_only=True)
class ThumbConfig(SimulatedFingerConfig):
    """Rest levels of a thumb, whose electrodes reach 3350: PDC is higher, electrodes are lower than of other fingers."""

    pdc_rest: float = setting(2779.0, "PDC without contact", unit="counts", bounds=(1.0, 4094.0))
    electrode_rest: float = setting(
        3150.0, "Mean of the electrodes without contact", unit="counts", bounds=(500.0, 4000.0)
    )


@dataclass(frozen=True, eq=False)
class Finger:
    """One fingertip."""

    pdc_rest: float  # PDC without contact [counts]
    pdc_span: float  # rise of PDC where it levels off [counts]
    electrode_rest: Float64  # (24,) float64 [counts]
    electrode_gain: Float64  # (24,) float64, factor on the approach of the skin

    @property
    def rest(self) -> Float64:
        """(25,) counts without contact: PDC, then electrodes."""
        return np.append(self.pdc_rest, self.electrode_rest)


def draw_finger(config: SimulatedFingerConfig, rng: np.random.Generator) -> Finger:
    """One fingertip of a kind."""
    rest = config.electrode_rest + REST_SPREAD * rng.standard_normal(ELECTRODES)
    gain = np.exp(GAIN_SPREAD * rng.standard_normal(ELECTRODES))
    return Finger(config.pdc_rest, config.pdc_span, np.clip(rest, *_REST_LIMITS), gain)


def read_contact(pad: PadConfig, finger: Finger, window: PadWindow, solution: ContactSolution) -> Float64:
    """Counts of a fingertip in contact, before noise and rounding; without force, its rest to the bit.

    Args:
        pad: Shape of the pad and of the window.
        finger: Rest and gain.
        window: Where the pad is touched.
        solution: Of the contact; the first of its layers is the skin.

    Returns:
        (25,) float64 [counts], PDC then electrodes.
    """
    if solution.force_n == 0.0:
        return finger.rest
    skin = solution.displacement[0]
    volume = _displaced_volume(skin, pad.step_m**2)
    approach = _skin_approach(_electrode_weights(pad, window.frame, window.points), skin, volume)
    electrodes = _electrode_counts(approach, finger.electrode_rest, finger.electrode_gain)
    return np.append(_pdc_counts(window.frame, volume, finger), electrodes)


def read_press(finger: Finger) -> Float64:
    """(25,) counts [counts] of a fingertip whose whole pad is pressed by a person, halfway to its largest pressure."""
    approach = 0.5 * THINNING_M * np.maximum(-BIOTAC_SP.layout.normals[:, 2], 0.0)
    electrodes = _electrode_counts(approach, finger.electrode_rest, finger.electrode_gain)
    return np.append(finger.pdc_rest + 0.5 * finger.pdc_span, electrodes)


def _displaced_volume(displacement: Float64, cell_m2: float) -> float:
    """Liquid pushed aside by the contact [m³]; where the skin's displacement is a rise, it takes liquid up."""
    return max(float(np.minimum(displacement, BOTTOMING_M).sum()) * cell_m2, 0.0)


def _pdc_counts(frame: ContactFrame, volume_m3: float, finger: Finger) -> float:
    """PDC in counts, not yet rounded, of a pad that is touched at a frame."""
    facing = math.pow(max(-float(frame.rotation[2, 2]), 0.0), RIM_POWER)
    return finger.pdc_rest + finger.pdc_span * facing * math.tanh(volume_m3 / SATURATION_M3)


def _electrode_weights(
    pad: PadConfig, frame: ContactFrame, skin_points: Float64, kernel_m: float = KERNEL_M
) -> Float64:
    """(24, N * N) float64, weight of each cell at each electrode; over a plane those of an electrode facing it sum to 1.

    `skin_points` (N, N, 3) are the cells on the skin in the frame of the fingertip [m]; not finite beside the pad.
    """
    points = skin_points.reshape(-1, 3)
    normals = BIOTAC_SP.layout.normals
    places = BIOTAC_SP.layout.positions + pad.layer_m * normals
    on_skin = np.isfinite(points.sum(axis=1))
    points = np.where(on_skin[:, None], points, 0.0)
    # |p - e|² = |p|² - 2 p·e + |e|², so that the bulk of the work is one product of matrices
    squares = np.einsum("ij,ij->i", points, points) - 2.0 * places @ points.T
    squares += np.einsum("ij,ij->i", places, places)[:, None]
    scale = pad.step_m**2 / (2.0 * math.pi * kernel_m**2)
    facing = np.maximum(normals @ frame.rotation[:, 2], 0.0)
    weights: Float64 = np.exp(squares * (-0.5 / kernel_m**2))
    weights *= (scale * facing)[:, None]
    weights *= on_skin
    return weights


def _skin_approach(weights: Float64, displacement: Float64, volume_m3: float) -> Float64:
    """(24,) float64 [m]: how much closer the skin is to each electrode; negative where it bulges."""
    return np.asarray(weights @ displacement.ravel() - volume_m3 / BULGE_AREA_M2)


def _electrode_counts(approach: Float64, rest: Float64, gain: Float64 | float = 1.0) -> Float64:
    """Counts (..., 24) of electrodes, not yet rounded, by the approach of `_skin_approach` and the counts without contact."""
    impedance_kohm = to_kohm(rest) * np.exp(np.clip(gain * approach / THINNING_M, -_MAX_EXPONENT, _MAX_EXPONENT))
    return np.asarray(FULL_SCALE / (1.0 + impedance_kohm / _REFERENCE_KOHM))


def quantise(counts: Float64) -> Int64:
    """Round and clip to 0..4095 as the 12-bit converter does; a `TactileError` if a value is not finite."""
    if not np.isfinite(counts).all():
        raise TactileError(f"counts: {np.count_nonzero(~np.isfinite(counts))} values are not finite")
    return np.clip(np.rint(counts), 0, FULL_SCALE).astype(np.int64)
