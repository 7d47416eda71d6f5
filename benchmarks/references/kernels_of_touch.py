# SPDX-License-Identifier: Apache-2.0
"""References of the tactile conversions and of the simulator: contact, grip, fingertip, rays."""

import mpmath
import numpy as np

from benchmarks.references.reference import EPS, Exact, exact, exp, gap, kernel, norm, relative_gap, span
from foretouch.tactile import BIOTAC_SP
from foretouch_lab.simulation.contact.grip import weigh
from foretouch_lab.simulation.contact.pad import PadConfig, contact_frame, pad_depth, pad_direction, pad_window
from foretouch_lab.simulation.contact.problem import ElasticLayer
from foretouch_lab.simulation.fingertip import (
    BOTTOMING_M,
    BULGE_AREA_M2,
    _displaced_volume,
    _electrode_weights,
    _skin_approach,
)

GEL = ElasticLayer(modulus_pa=1e6, poisson=0.3)


@kernel("pad: depth of the skin")
def _pad_depth(t: float, rng: np.random.Generator) -> tuple[float, float]:
    """Cells nearer and nearer to the place of touch, and to the rim of the pad."""
    config = PadConfig()
    frame = contact_frame(config, pad_direction(rng.uniform(-0.5, 0.5), rng.uniform(-0.5, 0.5)))
    x, y = np.array([span(t, 5e-3, 1e-8), 0.0]), np.array([0.0, 0.0])
    inverse = 1 / exact(config.skin_axes)
    turn, origin = exact(frame.rotation), exact(frame.origin)
    n = turn[:, 2] * inverse

    def quadratic(across: float) -> tuple[Exact, Exact, Exact]:
        o = (origin + exact(across) * turn[:, 1]) * inverse
        return o @ n, o @ o - 1, (o @ n) ** 2 - (n @ n) * (o @ o - 1)

    low, high = 0.0, 0.05  # the rim across the finger, by bisection
    for _ in range(60):
        middle = (low + high) / 2.0
        low, high = (middle, high) if quadratic(middle)[2] > 0 else (low, middle)
    y[1] = low * (1.0 - span(t, 0.5, 1e-13))
    found = pad_depth(config, frame, x, y)
    o = (origin + exact(x)[0] * turn[:, 0]) * inverse
    half, c = o @ n, o @ o - 1
    near = c / (half + mpmath.sqrt(half**2 - (n @ n) * c))
    half, c, discriminant = quadratic(y[1])
    rim = c / (half + mpmath.sqrt(discriminant))
    kappa = 1.0 + 0.01 / float(near) + min(float(half / mpmath.sqrt(discriminant)), EPS**-0.5)
    return kappa, relative_gap(found, np.array([near, rim], object))


@kernel("grip: shares of the weight")
def _weigh(t: float, rng: np.random.Generator) -> tuple[float, float]:
    """Contacts that approach each other, far from the origin."""
    place = rng.normal(size=3) * span(t, 0.1, 1e3)
    g1 = place + span(t, 0.05, 1e-5) * rng.normal(size=3)
    g2, centre, weight = place - 1e-5 * rng.normal(size=3), place + 1e-5 * rng.normal(size=3), rng.normal(size=3)
    found = weigh(weight, g1, g2, centre)
    a, b, c, w = map(exact, (g1, g2, centre, weight))
    length = norm(b - a)
    axis = (b - a) / length
    moment = np.cross(c - (a + b) / 2, w)
    across = w - (w @ axis) * axis
    couple = -np.cross(moment, axis) / (length / 2)
    size = float(norm(w))
    error = max(
        gap(found.axial_n, w @ axis),
        gap(found.tangential_n, np.stack([(-across - couple) / 2, (-across + couple) / 2])),
    )
    return 1.0 + float((norm(a) + norm(b) + norm(c)) / length), error / size


@kernel("electrodes: weights")
def _weights_of_electrodes(t: float, rng: np.random.Generator) -> tuple[float, float]:
    """Fields of 10 mm down to 0.1 mm."""
    kernel_m = span(t, 0.01, 1e-4)
    pad = PadConfig(cells=3)
    window = pad_window(pad, pad_direction(rng.uniform(-0.5, 0.5), rng.uniform(-0.5, 0.5)))
    points = window.points.reshape(-1, 3)
    positions, normals = BIOTAC_SP.layout.positions, BIOTAC_SP.layout.normals
    points[:4] = positions[:4] + pad.layer_m * normals[:4]  # some right at an electrode
    found = _electrode_weights(pad, window.frame, points.reshape(3, 3, 3), kernel_m)
    places = exact(positions) + exact(pad.layer_m) * exact(normals)
    squares = ((places[:, None] - exact(points)[None]) ** 2).sum(axis=2)
    facing = np.maximum(exact(normals) @ exact(window.frame.rotation[:, 2]), mpmath.mpf(0))
    scale = exact(pad.step_m) ** 2 / (2 * mpmath.pi * exact(kernel_m) ** 2)
    wanted = scale * facing[:, None] * exp(-squares / (2 * exact(kernel_m) ** 2))
    return float((points**2).sum(axis=1).max()) / kernel_m**2, gap(found, wanted) / float(wanted.max())


@kernel("electrodes: approach of the skin")
def _approach(t: float, rng: np.random.Generator) -> tuple[float, float]:
    """Indentation and bulge that cancel more and more."""
    u = rng.uniform(0.0, 5e-4, (6, 6))
    volume = _displaced_volume(u, 2.5e-7)
    reference = np.minimum(exact(u), exact(BOTTOMING_M)).sum() * exact(2.5e-7)
    weights = rng.random((1, 36))
    bulge = float(reference) / BULGE_AREA_M2
    weights *= bulge * (1.0 + span(t, 1.0, 1e-9)) / (weights @ u.ravel())
    wanted = (exact(weights) @ exact(u.ravel()))[0] - reference / exact(BULGE_AREA_M2)
    kappa = float((weights @ u.ravel())[0] + bulge) / abs(float(wanted))
    return kappa, relative_gap(_skin_approach(weights, u, volume)[0], wanted)
