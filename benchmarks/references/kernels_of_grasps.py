# SPDX-License-Identifier: Apache-2.0
"""References of the kernels of GeoGrasp, `original` and `stable`, and of rotations."""

import mpmath
import numpy as np
from foretouch.grasp.stable import (
    ObjectFrame,
    StableRanking,
    StableSide,
    WeightedPoints,
    _third_moment,
    object_frame,
    soft_extremes,
    stable_side,
    weigh_points,
)
from foretouch.grasp.stable import _local_planes as planes_at
from foretouch.grasp.stable import _onto_surface as surface_mean

from benchmarks.references.reference import (
    Exact,
    Float64,
    covariance,
    eigen,
    exact,
    exp,
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
from foretouch.grasp.config import SEARCH_VOXELS, GeoGraspConfig
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


@kernel("outlier weights, stable")
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


@kernel("object centroid, stable")
def _centroid(t: float, rng: np.random.Generator) -> tuple[float, float]:
    points = _object(t, rng)
    centre, spread = covariance(exact(points.xyz), exact(points.area))
    size = float(eigen(spread)[0][2]) ** 0.5
    found = object_frame(points, Plane.from_coefficients([0.0, 0.0, 1.0, -1.0]))
    return float(np.abs(points.xyz).max()) / size, gap(found.centroid, centre) / size


@kernel("object frame, stable")
def _frame(t: float, rng: np.random.Generator) -> tuple[float, float]:
    points = _object(t, rng)
    plane = Plane.from_coefficients(np.append(rng.normal(size=3), -1.0))
    found = object_frame(points, plane)
    centre, spread = covariance(exact(points.xyz), exact(points.area))
    plain, _ = eigen(spread)
    preferred = exact(PREFERRED)
    values, vectors = eigen(spread + exact(0.01) * plain[2] * np.outer(preferred, preferred))
    axis = vectors[:, 2]
    up = exact(plane.normal)
    up = -up if up @ centre > 0 else up
    share = smoothstep(np.abs(up @ axis), exact(0.45), exact(0.65))
    blend = (1 - share) * np.cross(up, axis) + share * np.cross(axis, _unit(centre))
    across = blend - (blend @ axis) * axis
    length = norm(across)
    _, middle, high = real(values)
    kappa = high / (high - middle) / float(length)
    sign = 1 if found.axis @ real(axis) > 0 else -1  # both are turned together; the rule for it has its own row
    return kappa, max(gap(found.axis, sign * axis), gap(found.across, sign * across / length))


@kernel("asymmetry of the sign, stable")
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


def _flat_frame(rng: np.random.Generator, place: Float64) -> ObjectFrame:
    turn = rotation(rng)
    return ObjectFrame(place, turn[:, 0], turn[:, 1], 0.5, np.eye(3))


@kernel("initial points, stable")
def _extremes(t: float, rng: np.random.Generator) -> tuple[float, float]:
    """Objects of 2 cm to 5 m, at up to 1 km."""
    size, place = span(t, 0.02, 5.0), span(t, 0.3, 1e3) * np.array([0.1, 0.2, 1.0])
    frame = _flat_frame(rng, place)
    local = rng.uniform(-1.0, 1.0, (40, 3)) * [0.007, size / 2.0, 0.02]
    xyz = place + local @ np.stack([frame.axis, frame.across, np.cross(frame.axis, frame.across)])
    points = WeightedPoints(xyz, rng.uniform(0.3, 1.0, 40), np.ones(40), 0)
    computed, _ = soft_extremes(points, frame, 0.001, 0.007)
    offset = exact(xyz) - exact(place)
    share = ((offset @ exact(frame.axis) - exact(0.001)) / (exact(1.5) * exact(0.007))) ** 2
    near = np.maximum(1 - share, exact(0.0)) ** 2 * exact(points.inlier)
    along = offset @ exact(frame.across)
    ends = []
    for sign in (-1, 1):
        weight = near * exp((sign * along - max((sign * along)[near > 0])) / exact(0.001))
        ends.append(weight @ exact(xyz) / weight.sum())
    return float(np.abs(xyz).max() / size), gap(computed, np.stack(ends)) / size


@kernel("candidates, stable")
def _candidates(t: float, rng: np.random.Generator) -> tuple[float, float]:
    """Tents around an initial point at up to 1 km; candidates with the weight of half a point and more count."""
    place = span(t, 0.3, 1e3) * np.array([0.1, 0.2, 1.0])
    frame = _flat_frame(rng, place)
    xyz = place + rng.uniform(-0.015, 0.015, (15, 3))
    points = WeightedPoints(xyz, rng.uniform(0.3, 1.0, 15), np.ones(15), 0)
    found = stable_side(points, place, frame, 0.3, CONFIG)
    offset = exact(xyz) - exact(place)
    radius, voxel = exact(SEARCH_VOXELS * CONFIG.voxel_m), exact(CONFIG.voxel_m)
    weight = exact(points.inlier) * (1 - smoothstep(norm(offset), radius * exact(0.9), radius * exact(1.1)))
    basis = np.stack([exact(frame.axis), exact(frame.across), np.cross(exact(frame.axis), exact(frame.across))])
    scaled = offset @ basis.T / voxel
    nodes: dict[tuple[int, ...], list[Exact]] = {}
    for w, place_, s in zip(weight, exact(xyz), scaled, strict=True):
        low = [int(mpmath.floor(v)) for v in s]
        for corner in np.ndindex(2, 2, 2):
            tent = w * np.prod([(v - f) if c else 1 - (v - f) for v, f, c in zip(s, low, corner, strict=True)])
            nodes.setdefault(tuple(f + c for f, c in zip(low, corner, strict=True)), []).append((tent, place_))
    wanted = [(sum(tent for tent, _ in one), one) for _, one in sorted(nodes.items())]
    centres = [sum(tent * p for tent, p in one) / mass for mass, one in wanted if mass > 0.5]
    apart = np.array([min(gap(one, centre) for one in found.xyz[1:]) for centre in centres])
    kappa = (np.abs(xyz).max() + SEARCH_VOXELS * CONFIG.voxel_m) / CONFIG.voxel_m / 0.5
    return float(kappa), float(apart.max()) / CONFIG.voxel_m


@kernel("normals and curvature, stable")
def _local_planes(t: float, rng: np.random.Generator) -> tuple[float, float]:
    """Two ever narrower patches, up to 0.5 m apart, at up to 1 km."""
    flat = rng.uniform(-1.0, 1.0, (2, 24, 3)) * [0.01, 0.01 * span(t, 0.9, 0.01), 2e-5]
    middle = np.array([[0.0, 0.0, 0.0], [span(t, 0.03, 0.5), 0.0, 0.0]])
    turn, place = rotation(rng), span(t, 0.3, 1e3) * np.array([0.1, 0.2, 1.0])
    xyz = (flat + middle[:, None]).reshape(-1, 3) @ turn.T + place
    centres = middle @ turn.T + place
    points = WeightedPoints(xyz, rng.uniform(0.3, 1.0, 48), np.ones(48), 0)
    normal, curvature = planes_at(points, centres, 0.03)
    kappa, error = 0.0, 0.0
    for k in range(2):
        squared = ((exact(xyz) - exact(centres[k])) ** 2).sum(axis=1)
        weight = np.maximum(1 - squared / exact(0.03) ** 2, exact(0.0)) * exact(points.inlier)
        mean, spread = covariance(exact(xyz), weight)
        values, vectors = eigen(spread)
        low, between, _ = real(values)
        shift = float(norm(mean - exact(centres.mean(axis=0))))
        kappa = max(kappa, (shift**2 + 0.03**2) / (between - low))
        error = max(error, gap_up_to_sign(normal[k], vectors[:, 0]), gap(curvature[k], values[0] / values.sum()))
    return kappa, error


@kernel("score, stable")
def _stable_score(t: float, rng: np.random.Generator) -> tuple[float, float]:
    """All candidates come nearer and nearer to the grasp plane, and the surface gets flat."""
    frame = _flat_frame(rng, np.array([0.1, 0.05, 1.0]))
    sides = []
    for sign in (-1.0, 1.0):
        local = rng.uniform(-1.0, 1.0, (5, 3)) * [0.02 * span(t, 1.0, 1e-6), 0.005, 0.02]
        local[:, 1] += sign * 0.03
        xyz = frame.centroid + local @ np.stack([frame.axis, frame.across, np.cross(frame.axis, frame.across)])
        normal = rng.normal(size=(5, 3))
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        curvature = rng.uniform(0.0, 0.3, 5) * span(t, 1.0, 1e-6)
        sides.append(StableSide(xyz, rng.uniform(0.1, 1.0, 5), normal, curvature, 5))
    points = WeightedPoints(sides[0].xyz, np.ones(5), np.ones(5), 0)
    computed = StableRanking(points, (sides[0], sides[1]), frame, 0.0, 0.03).pairs().score
    axis, scaled, kappa = exact(frame.axis), [], 10.0
    for side in sides:
        mass, away = exact(side.mass), exact(side.xyz) - exact(frame.centroid)
        values = np.abs(away @ axis), exact(side.curvature)
        largest = [max((mass * v**3) @ v / (mass * v**3).sum(), exact(1e-9)) for v in values]
        scaled.append([v / top for v, top in zip(values, largest, strict=True)])
        kappa += float(norm(away).max() / largest[0] + values[1].max() / largest[1])
    (pd_a, k_a), (pd_b, k_b) = scaled
    apart = exact(sides[1].xyz)[None] - exact(sides[0].xyz)[:, None]
    unit = apart / norm(apart)[..., None]
    c_a = np.abs((unit * exact(sides[0].normal)[:, None]).sum(axis=2))
    c_b = np.abs((unit * exact(sides[1].normal)[None]).sum(axis=2))
    r1 = 2 - pd_a[:, None] - pd_b[None] - 10 * (np.abs(unit @ axis) - exact(0.2))
    r2 = 2 - k_a[:, None] - k_b[None] + c_a + c_b - np.abs(c_a - c_b)
    return kappa, gap(computed, exact(1.5) * r1 + r2)


@kernel("contact on the surface, stable")
def _onto_surface(t: float, rng: np.random.Generator) -> tuple[float, float]:
    """A place farther and farther off the surface, at up to 1 km."""
    place = span(t, 0.3, 1e3) * np.array([0.1, 0.2, 1.0])
    off = span(t, 0.0005, 0.3)
    xyz = place + np.column_stack([rng.uniform(-0.003, 0.003, (30, 2)), off + 1e-4 * rng.random(30)])
    points = WeightedPoints(xyz, rng.uniform(0.2, 1.0, 30), np.ones(30), 0)
    squared = ((exact(xyz) - exact(place)) ** 2).sum(axis=1)
    weight = exact(points.inlier) * exp(-(squared - squared.min()) / (2 * exact(0.002) ** 2))
    kappa = 1.0 + float(squared.max()) / 4e-6 + np.abs(xyz).max() / 2e-3
    return float(kappa), gap(surface_mean(points, place), weight @ exact(xyz) / weight.sum()) / 0.002


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
    # The rounded matrix is no exact rotation: the error is that of its nine roundings and the conversion.
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
