# SPDX-License-Identifier: Apache-2.0
"""References of the tactile conversions and of the simulator: contact, grip, fingertip, rays."""

import math

import mpmath
import numpy as np
from scipy.integrate import quad
from scipy.special import j0

from benchmarks.references.reference import (
    EPS,
    Exact,
    exact,
    exp,
    gap,
    kernel,
    norm,
    real,
    relative_gap,
    rotation,
    solve,
    span,
)
from foretouch.simulation.contact import Command, ContactProblem, Layer, PadConfig
from foretouch.simulation.contact.closed_form import _displacement, _ellipse, _fit, solve_winkler
from foretouch.simulation.contact.grip import weigh
from foretouch.simulation.contact.layer import _layer_transfer, _love_influence, _smooth_part
from foretouch.simulation.contact.pad import contact_frame, pad_depth, pad_direction, pad_window
from foretouch.simulation.fingertip import (
    BOTTOMING_M,
    BULGE_AREA_M2,
    _displaced_volume,
    _electrode_weights,
    _skin_approach,
)
from foretouch.simulation.solids import Body
from foretouch.tactile import electrode_normals, electrode_positions

SKIN = Layer(modulus_pa=1.552e6, poisson=0.316, thickness_m=0.0015)
GEL = Layer(modulus_pa=1e6, poisson=0.3)


@kernel("Hertz: ellipse")
def _hertz_ellipse(t: float, rng: np.random.Generator) -> tuple[float, float]:
    """From a circle to an ellipse of 1 : 100."""
    ratio = mpmath.mpf(span(t, 1.0 - 1e-6, 0.0102)) ** rng.uniform(0.95, 1.0)
    m = 1 - ratio**2
    k, e = mpmath.ellipk(m), mpmath.ellipe(m)
    found = _ellipse(float((e / ratio**2 - k) / (k - e)))
    return 1.0 + (np.log(100.0) / 1999.0) ** 2 / EPS, relative_gap(found, np.array([ratio, k, (k - e) / m], object))


@kernel("Hertz: curvature of the gap")
def _hertz_fit(t: float, rng: np.random.Generator) -> tuple[float, float]:
    """A flatter and flatter paraboloid."""
    n, step = 9, 1e-4
    offset = (np.arange(n) - (n - 1) / 2.0) * step
    x, y = np.meshgrid(offset, offset)
    curvature = span(t, 200.0, 1e-6)
    gap_field = curvature * (x**2 + rng.uniform(0.1, 0.9) * y**2)
    problem = ContactProblem(gap_field, step, (GEL,))
    found = _fit(problem)
    patch = exact(gap_field[1:8, 1:8].ravel())
    i, j = np.meshgrid(np.arange(-3.0, 4.0), np.arange(-3.0, 4.0))
    design = exact(
        np.column_stack([np.ones(49), i.ravel(), j.ravel(), i.ravel() ** 2, (i * j).ravel(), j.ravel() ** 2])
    )
    fit = solve(design.T @ design, design.T @ patch) / exact(step) ** 2
    mean, half = (fit[3] + fit[5]) / 2, mpmath.sqrt(((fit[3] - fit[5]) / 2) ** 2 + (fit[4] / 2) ** 2)
    large = float(mean + half)
    error = gap([found.a, found.b], np.array([mean - half, mean + half], object)) / large
    return float(np.abs(real(patch)).max()) / (large * step**2), error


@kernel("Hertz: displacement")
def _hertz_displacement(t: float, rng: np.random.Generator) -> tuple[float, float]:
    """From the middle of the footprint to 1e12 of its radii."""
    rho = span(t, 0.1, 1e12) * rng.uniform(0.5, 1.0)
    r = mpmath.mpf(rho)
    wanted = 1 - r**2 / 2 if rho <= 1.0 else ((2 - r**2) * mpmath.asin(1 / r) + mpmath.sqrt(r**2 - 1)) / mpmath.pi
    kappa = 1.0 if rho > 1e4 else max(1.0, rho**2)
    return kappa, relative_gap(_displacement(np.array([[rho]]), 1.0), wanted)


def _bowl(n: int, side: float, radius: float = 0.01) -> ContactProblem:
    offset = (np.arange(n) - (n - 1) / 2.0) * side / n
    x, y = np.meshgrid(offset, offset)
    field = (x**2 + 0.7 * y**2) / (2.0 * radius)
    return ContactProblem(field - field.min(), side / n, (SKIN,))


@kernel("Winkler: depth and pressure")
def _winkler(t: float, rng: np.random.Generator) -> tuple[float, float]:
    """Forces of 10 N to 1e-20 N."""
    problem = _bowl(7, 0.004 * rng.uniform(0.5, 1.0))
    force = span(t, 10.0, 1e-20)
    found = solve_winkler(problem, Command(force_n=force))
    nu = exact(SKIN.poisson)
    k = exact(SKIN.modulus_pa) * (1 - nu) / ((1 + nu) * (1 - 2 * nu)) / exact(SKIN.thickness_m)
    total = exact(force) / (k * exact(problem.step_m) ** 2)
    gaps = np.sort(exact(problem.gap).ravel())
    depths = [(total + gaps[: n + 1].sum()) / (n + 1) for n in range(len(gaps))]
    n = next(n for n, depth in enumerate(depths) if n + 1 == len(gaps) or depth <= gaps[n + 1])
    depth = depths[n]
    pressure = k * np.maximum(depth - exact(problem.gap), mpmath.mpf(0))
    kappa = float((depth * (n + 1) + gaps[: n + 1].sum()) / (depth * (n + 1) - gaps[: n + 1].sum()))
    return kappa, max(relative_gap(found.depth_m, depth), gap(found.pressure, pressure) / float(pressure.max()))


@kernel("layer: transfer function")
def _transfer(t: float, rng: np.random.Generator) -> tuple[float, float]:
    """Waves of 1e-9 to 300 thicknesses, up to ν = 0.5."""
    at, nu = span(t, 1e-9, 300.0), float(rng.choice([0.0, 0.3, 0.5]))
    q, n = mpmath.mpf(at), mpmath.mpf(nu)
    top = (3 - 4 * n) * mpmath.sinh(2 * q) - 2 * q
    below = (3 - 4 * n) * mpmath.cosh(2 * q) + 2 * q**2 + 5 - 12 * n + 8 * n**2
    return 1.0, gap(_layer_transfer(at, nu), top / below)


@kernel("layer: Love's rectangle")
def _love(t: float, rng: np.random.Generator) -> tuple[float, float]:
    """From the cell itself to 1000 cells away."""
    step, cells = 10.0 ** rng.uniform(-9.0, 0.0), np.floor(span(t, 1.0, 1000.0) * rng.uniform(0.5, 1.0, 2))
    x, y = np.array([cells[0] * step]), np.array([cells[1] * step])
    s, a, b = exact(step) / 2, exact(x)[0], exact(y)[0]

    def corner(u: Exact, v: Exact) -> Exact:
        return u * mpmath.asinh(v / abs(u)) + v * mpmath.asinh(u / abs(v))

    wanted = corner(a + s, b + s) + corner(a - s, b - s) - corner(a + s, b - s) - corner(a - s, b + s)
    kappa = 1.0 + float((cells**2).sum())
    return kappa, relative_gap(_love_influence(x, y, step, 1e6)[0], wanted / (mpmath.pi * 1000000))


@kernel("layer: smooth part")
def _smooth(t: float, rng: np.random.Generator) -> tuple[float, float]:
    """Distances of 0 to 20 thicknesses; the adaptive quadrature is exact to 1e-13."""
    rho, n = 20.0 * t * rng.uniform(0.97, 1.0), float(rng.choice([0.0, 0.316, 0.5]))

    def less(q: float) -> float:  # M - 1, with all powers of exp(-2q) written out
        d = math.exp(-2.0 * q)
        below = (3.0 - 4.0 * n) * (1.0 + d * d) + 2.0 * d * (2.0 * q**2 + 5.0 - 12.0 * n + 8.0 * n**2)
        return -2.0 * d * (2.0 * q + (3.0 - 4.0 * n) * d + 2.0 * q**2 + 5.0 - 12.0 * n + 8.0 * n**2) / below

    wanted, middle = (
        quad(lambda q, at=at: less(q) * j0(q * at), 0.0, 30.0, epsabs=1e-13, epsrel=1e-13, limit=400)[0]
        for at in (rho, 0.0)
    )
    return 1.0 + 5e-3**2 / EPS, abs(float(_smooth_part(np.array([rho]), n)[0]) - wanted) / abs(middle)


@kernel("pad: place of a direction")
def _pad_frame(t: float, rng: np.random.Generator) -> tuple[float, float]:
    """Directions nearer and nearer to the tip."""
    config = PadConfig()
    direction = pad_direction(np.pi / 2.0 - span(t, 1.5, 1e-7), rng.uniform(-1.0, 1.0)) * rng.uniform(0.1, 10.0)
    found = contact_frame(config, direction)
    n = exact(direction) / norm(exact(direction))
    axes = exact(config.skin_axes)
    origin = axes**2 * n / norm(axes * n)
    x = exact([1.0, 0.0, 0.0]) - n[0] * n
    length = norm(x)
    x = x / length
    wanted = np.column_stack([x, np.cross(n, x), n])
    return 1.0 / float(length), max(gap(found.origin, origin) / 0.01, gap(found.rotation, wanted))


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
    points[:4] = electrode_positions()[:4] + pad.layer_m * electrode_normals()[:4]  # some right at an electrode
    found = _electrode_weights(pad, window.frame, points.reshape(3, 3, 3), kernel_m)
    places = exact(electrode_positions()) + exact(pad.layer_m) * exact(electrode_normals())
    squares = ((places[:, None] - exact(points)[None]) ** 2).sum(axis=2)
    facing = np.maximum(exact(electrode_normals()) @ exact(window.frame.rotation[:, 2]), mpmath.mpf(0))
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


@kernel("ray meets a mesh")
def _ray_mesh(t: float, rng: np.random.Generator) -> tuple[float, float]:
    """The flat top of a box, from 0.2 m to 1 km and at ever flatter angles."""
    size, turn = np.array([0.2, 0.2, 0.1]), rotation(rng)
    body = Body("box", 0, size, rng.normal(size=3), turn)
    cosine = span(t, 1.0, 0.05)
    local = np.array([np.sqrt(1.0 - cosine**2), 0.0, -cosine])
    target = np.array([rng.uniform(-0.03, 0.03), rng.uniform(-0.03, 0.03), 0.05])
    direction = turn @ local
    origin = body.position + turn @ target - span(t, 0.2, 1e3) * direction
    found = body.cast(origin, direction[None]).t[0]
    start = (exact(origin) - exact(body.position)) @ exact(turn)
    along = exact(direction) @ exact(turn)
    wanted = (exact(0.05) - start[2]) / along[2]
    distance = float(norm(start))
    return (distance + 0.2) / 0.1 / cosine, gap(found, wanted) / 0.2
