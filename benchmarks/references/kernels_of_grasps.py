# SPDX-License-Identifier: Apache-2.0
"""References of the kernels of both methods of grasps, `original` and `completed`, and of rotations."""

import mpmath
import numpy as np

from benchmarks.references.reference import (
    Exact,
    covariance,
    eigen,
    exact,
    far_or_round,
    gap,
    gap_up_to_sign,
    kernel,
    norm,
    real,
    relative_gap,
    rotation,
    smoothstep,
    span,
    spread_points,
)
from foretouch.grasp.config import GeoGraspConfig
from foretouch.grasp.frame import WeightedPoints, _third_moment, object_frame, weigh_points
from foretouch.grasp.pose import hand_rotation, quaternion_xyzw
from foretouch.grasp.ranking import GraspPlane, SurfacePoints, _plane_distance, _ScaledSide, _two_rankings
from foretouch.types import Plane

CONFIG = GeoGraspConfig()


def _unit(vector: Exact) -> Exact:
    return vector / norm(vector)


@kernel("distance from the grasp plane")
def _distance(t: float, rng: np.random.Generator) -> tuple[float, float]:
    """Points nearer and nearer to a plane, up to 10 km from the origin."""
    turn = rotation(rng)
    origin = rng.normal(size=3) * span(t, 1.0, 1e4)
    point = origin + turn @ [0.05, -0.03, span(t, 0.02, 1e-7)]
    plane = GraspPlane(origin, turn[:, 2], 0, 1, 2, 0.1)
    offset = exact(point) - exact(origin)
    distance = np.abs(offset @ exact(turn[:, 2]))
    return float(norm(offset) / distance), relative_gap(_plane_distance(point[None], plane)[0], distance)


def _surface(rng: np.random.Generator, n: int, spread: float) -> SurfacePoints:
    """Candidates whose distances and curvatures differ by the share `spread`."""
    xyz = np.array([0.03, 0.02, 1.0]) + spread * rng.uniform(-0.02, 0.02, (n, 3))
    normal = rng.normal(size=(n, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return SurfacePoints(xyz, normal, 0.05 + spread * rng.uniform(0.0, 0.05, n))


@kernel("score, original")
def _score(t: float, rng: np.random.Generator) -> tuple[float, float]:
    """The candidates of a side become alike, down to a range of 2e-8, at which the original's epsilon takes over."""
    axis = rotation(rng)[:, 0]
    plane = GraspPlane(np.array([0.0, 0.01, 1.01]), axis, 0, 1, 2, 0.06)
    points = [_surface(rng, 6, span(t, 1.0, 3e-6)) for _ in range(2)]
    sides = [_ScaledSide(one, plane, plane.origin) for one in points]
    unit = rng.normal(size=(6, 3))
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    a, b = sides
    r1, r2 = _two_rankings(unit, axis, (a.normal, b.normal), (a.pd, b.pd), (a.k, b.k))
    kappa, scaled = 10.0, []
    epsilon = exact(1e-8)
    for one in points:
        away = exact(one.xyz) - exact(plane.origin)
        values = np.abs(away @ exact(axis)), exact(one.curvature)
        scaled.append([(v + epsilon - v.min()) / (v.max() - v.min()) for v in values])
        kappa += float(norm(away).max() / np.ptp(values[0])) + float(values[1].max() / np.ptp(values[1]))
    (pd_a, k_a), (pd_b, k_b) = scaled
    u = exact(unit)
    c_a, c_b = (np.abs((u * exact(one.normal)).sum(axis=1)) + epsilon for one in points)
    first = 2 - pd_a - pd_b - 10 * (np.abs(u @ exact(axis)) + epsilon - exact(0.2))
    second = 2 - k_a - k_b + c_a + c_b - np.abs(c_a - c_b)
    return kappa, gap(1.5 * r1 + r2, exact(1.5) * first + second)


@kernel("outlier weights, completed")
def _weights(t: float, rng: np.random.Generator) -> tuple[float, float]:
    """The distances to the neighbours become more and more equal."""
    distance = (0.002 * (1.0 + span(t, 0.5, 1e-5) * rng.random(40))).astype(np.float32)
    computed = weigh_points(rng.random((40, 3)).astype(np.float32), distance, CONFIG).inlier
    d = exact(distance)
    mean = d.sum() / 40
    deviation = mpmath.sqrt(((d - mean) ** 2).sum() / 39)
    limit, fade = mean + exact(CONFIG.outlier_deviations) * deviation, deviation / 4 + exact(1e-9)
    return float(d.max() / fade), gap(computed, 1 - smoothstep(d, limit - fade, limit + fade))


def _object(t: float, rng: np.random.Generator, n: int = 40) -> WeightedPoints:
    """An object far away, or with two nearly equal eigenvalues."""
    far, difference = far_or_round(t, rng, 1e3)
    shape = spread_points(rng, n, [0.04, 0.04 * (1.0 - difference), 0.01])
    points = shape @ rotation(rng).T + far * np.array([0.1, -0.1, 1.0])
    inlier = rng.uniform(0.2, 1.0, n)
    return WeightedPoints(points, inlier, inlier * rng.uniform(1e-6, 4e-6, n), 0)


PREFERRED = [0.95, 0.3, 0.08]


@kernel("object centroid, completed")
def _centroid(t: float, rng: np.random.Generator) -> tuple[float, float]:
    points = _object(t, rng)
    centre, spread = covariance(exact(points.xyz), exact(points.area))
    size = float(eigen(spread)[0][2]) ** 0.5
    found = object_frame(points, Plane.from_coefficients([0.0, 0.0, 1.0, -1.0]))
    return float(np.abs(points.xyz).max()) / size, gap(found.centroid, centre) / size


@kernel("object frame, completed")
def _frame(t: float, rng: np.random.Generator) -> tuple[float, float]:
    points = _object(t, rng)
    plane = Plane.from_coefficients(np.append(rng.normal(size=3), -1.0))
    found = object_frame(points, plane)
    _, spread = covariance(exact(points.xyz), exact(points.area))
    plain, _ = eigen(spread)
    preferred = exact(PREFERRED)
    values, vectors = eigen(spread + exact(0.01) * plain[2] * np.outer(preferred, preferred))
    axis = vectors[:, 2]
    _, middle, high = real(values)
    sign = 1 if found.axis @ real(axis) > 0 else -1  # the rule for it has its own row
    return high / (high - middle), gap(found.axis, sign * axis)


@kernel("asymmetry of the sign, completed")
def _asymmetry(t: float, rng: np.random.Generator) -> tuple[float, float]:
    """Symmetric but for less and less; one point is farther and farther away."""
    along = rng.normal(size=20) * span(t, 1e-9, 1e3)
    along = np.concatenate(
        [along, -along * (1.0 + span(t, 0.5, 1e-9) * rng.random(20)), [along.max() * span(t, 1.0, 1e3)]]
    )
    weight = rng.random(41)
    weight[20:40] = weight[:20]
    w, x = exact(weight), exact(along)
    power = (w @ x**2) ** exact(1.5)
    return float(w @ np.abs(x) ** 3 / power), gap(_third_moment(weight, along), w @ x**3 / power)


@kernel("rotation of the hand")
def _hand(t: float, rng: np.random.Generator) -> tuple[float, float]:
    """The contacts are more and more in line with the axis; they are 1e-3 to 1e-300 m apart, and so is the axis long."""
    turn = rotation(rng)
    axis = turn[:, 0] * span(t, 1.0, 1e-300)
    between = (turn[:, 0] + span(t, 1.0, 3e-6) * turn[:, 1]) * span(t, 1e-3, 1e-300)
    g2 = rng.normal(size=3) if t == 0.0 else np.zeros(3)
    g1 = g2 + between
    z = _unit(exact(g1) - exact(g2))
    x = np.cross(z, _unit(exact(axis)))
    sine = norm(x)
    x = x / sine
    return 1.0 / float(sine), gap(hand_rotation(g1, g2, axis), np.column_stack([x, np.cross(z, x), z]))


@kernel("rotation to quaternion")
def _to_quaternion(t: float, rng: np.random.Generator) -> tuple[float, float]:
    """Angles that approach a half turn, or zero."""
    axis, angle = rng.normal(size=3), span(abs(2.0 * t - 1.0), 1.0, 1e-12)
    q = np.append(axis / np.linalg.norm(axis) * np.cos(angle), np.sin(angle))
    if t > 0.5:
        q = np.append(axis / np.linalg.norm(axis) * np.sin(angle), np.cos(angle))
    reference = exact(q) / mpmath.sqrt((exact(q) ** 2).sum())
    # The rounded matrix is not an exact rotation: the error is that of its nine roundings and the conversion.
    return 1.0, gap_up_to_sign(quaternion_xyzw(real(_matrix(reference))), reference)


def _matrix(q: Exact) -> Exact:
    x, y, z, w = q
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ],
        object,
    )
