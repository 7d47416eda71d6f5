# SPDX-License-Identifier: Apache-2.0
"""The BioTac SP fingertip: from contact to the counts of the PDC channel and the electrodes, and what disturbs these.

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

**Disturbances**: noise, a slow scan, creep of the skin, drift with temperature, dead electrodes and slip. The defaults are
fitted to recordings of a BioTac SP in steady touch at 100 Hz. The electrodes are sampled one after the other in a ring; each
message takes what has been sampled since the last one, about 17 of 24, and repeats the rest: a block of about eight that
moves on from row to row.
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from foretouch.config import Settings, setting
from foretouch.errors import TactileError
from foretouch.tactile import BIOTAC_SP, ELECTRODES, FULL_SCALE, to_kohm
from foretouch.types import Float64, Int64
from foretouch_lab.simulation.contact.pad import PadConfig, PadWindow
from foretouch_lab.simulation.contact.problem import ContactSolution

_FRESH_PER_ROW: Final = 16.8  # electrodes that are sampled between two messages
_CUT_JITTER: Final = 1.0  # standard deviation of where a message cuts the ring [electrodes]

PDC_PER_KELVIN: Final = 8.0  # [counts/K]; orders of magnitude, not measurements: they differ from sensor to sensor
ELECTRODE_PER_KELVIN: Final = 12.0  # [counts/K]

BODY_KELVIN: Final = 3.0  # rise of the liquid's temperature since power-on, in the end
WARMING_S: Final = 600.0  # time constant of the warming
SESSION_S: Final = (0.0, 1800.0)  # from power-on to a grasp, low and high
TARE_AGE_S: Final = (2.0, 30.0)  # from a tare to its touch

TDC_PER_KELVIN: Final = 75.0  # [counts/K]; slope of the converter's curve between 2350 and 2700, where recordings are
TAC_PER_KELVIN_S: Final = 400.0  # [counts s/K]; an order of magnitude: recorded TAC varies by tens of counts
TAC_REST: Final = 2048.0  # TAC at a steady temperature
TDC_REST: Final = (2400.0, 2580.0)  # TDC of thumb and middle finger at power-on [counts], about as recorded

NOISE_ELECTRODE: Final = 4.2  # standard deviation of the white noise of an electrode [counts]
NOISE_PDC: Final = 0.3  # of PDC
WANDER_COUNTS: Final = 1.9  # standard deviation of the slow fluctuation of an electrode
WANDER_S: Final = 0.4  # time in which its correlation falls to 1/e

CREEP_SHARE: Final = 0.08  # part of the response that comes late
CREEP_TIME_S: Final = 1.5  # time constant of the late part

SLIP_SPEED_M_S: Final = 0.005  # mean speed of the object over the skin
SLIP_LENGTH_M: Final = 0.0005  # mean length of one slip


def ou_noise(
    rows: int, channels: int, counts: float, memory_s: float, rate_hz: float, rng: np.random.Generator
) -> Float64:
    """Return (rows, channels) Ornstein-Uhlenbeck noise, stationary from its first row.

    x_t = a x_{t-1} + √(1 - a²) ε_t with a = exp(-1 / (rate · memory)).

    Args:
        rows: Number of messages.
        channels: Number of independent processes.
        counts: Standard deviation [counts].
        memory_s: Time in which the correlation falls to 1/e [s].
        rate_hz: Of the messages [Hz].
        rng: Of the noise.
    """
    a = float(np.exp(-1.0 / (rate_hz * memory_s)))
    steps = counts * rng.standard_normal((rows, channels))
    steps[1:] *= np.sqrt(1.0 - a * a)
    for t in range(1, rows):
        steps[t] += a * steps[t - 1]
    return steps


def scan(series: Float64, rng: np.random.Generator) -> Float64:
    """Sample the channels of a series (T, C) in a ring: each message repeats those that were not sampled since the last."""
    rows, channels = series.shape
    cuts = rng.uniform(0.0, channels) + _FRESH_PER_ROW * np.arange(rows + 1)
    cuts += _CUT_JITTER * rng.standard_normal(rows + 1)
    cursor = np.maximum.accumulate(np.floor(cuts).astype(np.int64))
    fresh = (np.arange(channels) - cursor[:-1, None]) % channels < np.diff(cursor)[:, None]
    fresh[:1] = True
    sampled = np.where(fresh, np.arange(rows)[:, None], 0)
    return np.asarray(np.take_along_axis(series, np.maximum.accumulate(sampled, axis=0), axis=0))


def creep(series: Float64, rate_hz: float, *, share: float = CREEP_SHARE, time_s: float = CREEP_TIME_S) -> Float64:
    """Delay a series as the skin does, a standard linear solid: y = (1 - share) x + share · z, with dz/dt = (x - z) / time, at rest at first.

    A constant load creeps on, a released one leaves a rest that fades, and a cycle of load encloses an area:
    relaxation and hysteresis are one effect.

    Args:
        series: (T, ...) response x of an ideal fingertip, T at least 1.
        rate_hz: Of the messages [Hz].
        share: Part of the response that comes late.
        time_s: Time constant of that part [s].
    """
    late = np.array(series[0], np.float64)
    pull = -np.expm1(-1.0 / (rate_hz * time_s))
    result = np.empty_like(series, dtype=np.float64)
    for t, value in enumerate(series):
        late = late + pull * (value - late)
        result[t] = (1.0 - share) * value + share * late
    return result


def warming(times_s: Float64, body_kelvin: float = BODY_KELVIN, warming_s: float = WARMING_S) -> Float64:
    """Return (T,) float64: rise of the liquid's temperature [K] at times since power-on [s]."""
    return np.asarray(body_kelvin * -np.expm1(-times_s / warming_s))


def temperature_drift(rise_k: Float64) -> Float64:
    """Return (T, 25) float64: drift of PDC and electrodes [counts] by a rise of the temperature (T,) [K], not compensated in the sensor."""
    return np.outer(rise_k, [PDC_PER_KELVIN, *[ELECTRODE_PER_KELVIN] * ELECTRODES])


def slip_path(rows: int, rate_hz: float, rng: np.random.Generator) -> Float64:
    """Return (rows,) float64 [m]: how far the object has slid in the tangent plane, starting at 0, never back.

    It sticks for exponentially distributed times and slips by exponentially distributed lengths, which keep the mean speed.
    """
    slips = rng.poisson(SLIP_SPEED_M_S / (SLIP_LENGTH_M * rate_hz), rows)
    path = np.cumsum(rng.standard_gamma(np.maximum(slips, 1)) * SLIP_LENGTH_M * (slips > 0))
    return np.asarray(path - path[0]) if rows else path


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

    The defaults describe a middle finger: PDC as real ones at rest; electrodes so that in grasps their 95th
    percentile is near 3600, as of real ones.
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
    """Return one fingertip of a kind."""
    rest = config.electrode_rest + REST_SPREAD * rng.standard_normal(ELECTRODES)
    gain = np.exp(GAIN_SPREAD * rng.standard_normal(ELECTRODES))
    return Finger(config.pdc_rest, config.pdc_span, np.clip(rest, *_REST_LIMITS), gain)


def read_contact(pad: PadConfig, finger: Finger, window: PadWindow, solution: ContactSolution) -> Float64:
    """Return counts of a fingertip in contact, before noise and rounding; without force, its rest to the bit.

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
    cell_m2 = pad.step_m**2
    normal = window.frame.normal
    # Where the skin's displacement is a rise, it takes liquid up.
    volume_m3 = max(float(np.minimum(skin, BOTTOMING_M).sum()) * cell_m2, 0.0)
    approach = electrode_weights(pad, window) @ skin.ravel() - volume_m3 / BULGE_AREA_M2
    facing = math.pow(max(-float(normal[2]), 0.0), RIM_POWER)
    pdc = finger.pdc_rest + finger.pdc_span * facing * math.tanh(volume_m3 / SATURATION_M3)
    return np.append(pdc, electrode_counts(approach, finger.electrode_rest, finger.electrode_gain))


def read_press(finger: Finger) -> Float64:
    """Return (25,) counts [counts] of a fingertip whose whole pad is pressed by a person, halfway to its largest pressure."""
    approach = 0.5 * THINNING_M * np.maximum(-BIOTAC_SP.layout.normals[:, 2], 0.0)
    electrodes = electrode_counts(approach, finger.electrode_rest, finger.electrode_gain)
    return np.append(finger.pdc_rest + 0.5 * finger.pdc_span, electrodes)


def electrode_weights(pad: PadConfig, window: PadWindow) -> Float64:
    """Return (24, N * N) float64, weight of each cell at each electrode; over a plane the weights of an electrode facing it sum to 1."""
    points = window.points.reshape(-1, 3)
    normals = BIOTAC_SP.layout.normals
    places = BIOTAC_SP.layout.positions + pad.layer_m * normals
    on_skin = np.isfinite(points.sum(axis=1))
    points = np.where(on_skin[:, None], points, 0.0)
    # |p - e|² = |p|² - 2 p·e + |e|², so that the bulk of the work is one product of matrices
    squares = np.einsum("ij,ij->i", points, points) - 2.0 * places @ points.T
    squares += np.einsum("ij,ij->i", places, places)[:, None]
    scale = pad.step_m**2 / (2.0 * math.pi * KERNEL_M**2)
    facing = np.maximum(normals @ window.frame.normal, 0.0)
    weights: Float64 = np.exp(squares * (-0.5 / KERNEL_M**2))
    weights *= (scale * facing)[:, None]
    weights *= on_skin
    return weights


def electrode_counts(approach: Float64, rest: Float64, gain: Float64 | float = 1.0) -> Float64:
    """Return counts (..., 24) of electrodes, not yet rounded, by the approach of the skin [m] and the counts without contact.

    Args:
        approach: (..., 24) how much closer the skin is [m].
        rest: (..., 24) counts without contact.
        gain: Factor on the approach.
    """
    impedance_kohm = to_kohm(rest) * np.exp(np.clip(gain * approach / THINNING_M, -_MAX_EXPONENT, _MAX_EXPONENT))
    return np.asarray(FULL_SCALE / (1.0 + impedance_kohm / _REFERENCE_KOHM))


def quantise(counts: Float64) -> Int64:
    """Round and clip to 0..4095 as the 12-bit converter does; a `TactileError` if a value is not finite."""
    if not np.isfinite(counts).all():
        raise TactileError(f"counts: {np.count_nonzero(~np.isfinite(counts))} values are not finite")
    return np.clip(np.rint(counts), 0, FULL_SCALE).astype(np.int64)
