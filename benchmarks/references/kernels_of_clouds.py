# SPDX-License-Identifier: Apache-2.0
"""References of the kernels on clouds: camera, plane, moments, voxels, normals, neighbours, unit sphere."""

import mpmath
import numpy as np

from benchmarks.references.reference import (
    EPS,
    EPS32,
    Exact,
    Float64,
    covariance,
    eigen,
    exact,
    far_or_round,
    float32_cloud,
    gap,
    gap_up_to_sign,
    kernel,
    norm,
    real,
    relative_gap,
    rotation,
    solve,
    span,
    spread_points,
    sqrt,
)
from foretouch.camera.deproject import Deprojector, pinhole_matrix
from foretouch.cloud.geometry.pcl_filters import mean_neighbour_distance, normals_and_curvature, voxel_grid
from foretouch.cloud.geometry.sampling import UnitSphereFrame
from foretouch.cloud.segmentation.plane import PlaneConfig, fit_plane
from foretouch.cloud.segmentation.rays import _least_squares
from foretouch.grasp.axis import ObjectAxis, find_axis
from foretouch.grasp.config import GeoGraspConfig
from foretouch.grasp.hold import _measure
from foretouch.models.hand_history import place_and_size
from foretouch.types import ASSUMED_TABLE, Cloud, Plane


@kernel("deprojection")
def _deprojection(t: float, rng: np.random.Generator) -> tuple[float, float]:
    """The principal point comes closer and closer to a pixel."""
    matrix = pinhole_matrix(8, 6)
    matrix[:2, 2] = 3.0 + span(t, 0.3, 1e-9), 2.0 + span(t, 0.3, 1e-9)
    depth = rng.integers(1, 65536, (6, 8)).astype(np.uint16)
    computed = Deprojector.of_lens(matrix, 8, 6).points(depth, 0.001)
    z = exact(depth) * exact(0.001)
    x = (exact(np.arange(8)) - matrix[0, 2]) / matrix[0, 0] * z
    y = ((exact(np.arange(6)) - matrix[1, 2]) / matrix[1, 1])[:, None] * z
    return 1.0, relative_gap(computed, np.stack([x, y, z], axis=-1))


@kernel("undistortion")
def _undistortion(t: float, rng: np.random.Generator) -> tuple[float, float]:
    """Distortion grows until ten iterations, as in librealsense, are not enough."""
    k = span(t, 0.01, 0.17) * rng.uniform(0.8, 1.0, 5) * rng.choice([-1.0, 1.0], 5) * [1.0, 0.0, 0.1, 0.1, 1.0]
    k[1] = k[0]
    matrix = pinhole_matrix(4, 3)
    lens = Deprojector.of_lens(matrix, 4, 3, "brown_conrady", k.tolist())
    x = np.broadcast_to((exact(np.arange(4)) - matrix[0, 2]) / matrix[0, 0], (3, 4))
    y = np.broadcast_to(((exact(np.arange(3)) - matrix[1, 2]) / matrix[1, 1])[:, None], (3, 4))
    k1, k2, p1, p2, k3 = exact(k)
    u, v, changes = x, y, []
    size = np.abs(real(x)).max()
    for step in range(200):
        r2 = u * u + v * v
        radial = 1 + ((k3 * r2 + k2) * r2 + k1) * r2
        new_u = (x - 2 * p1 * u * v - p2 * (r2 + 2 * u * u)) / radial
        new_v = (y - 2 * p2 * u * v - p1 * (r2 + 2 * v * v)) / radial
        moved = max(gap(new_u, u), gap(new_v, v)) / size
        changes.append(moved)
        u, v = new_u, new_v
        if step > 9 and moved < 1e-12:
            break
    kappa = 1.0 + changes[9] / (1.0 - changes[9] / changes[8]) / EPS32
    return kappa, max(gap(lens.x, u), gap(lens.y, v)) / size


@kernel("ray fit")
def _ray_fit(t: float, rng: np.random.Generator) -> tuple[float, float]:
    """The points with depth shrink to a small window in the far corner of the image."""
    pixels = np.floor(rng.uniform(0.0, span(t, 700.0, 3.0), (30, 2))) + span(t, 1.0, 4.0) * np.array([1000.0, 500.0])
    design = np.column_stack([np.ones(30), pixels])
    tangents = (pixels - [640.0, 360.0]) / 900.0 + 1e-3 * rng.normal(size=(30, 2))
    rays = _least_squares(design, tangents)
    p = exact(design)
    best = solve(p.T @ p, p.T @ exact(tangents))
    squared = float(np.linalg.cond(design)) ** 2
    # `pinv` drops the smallest direction, by which the tangents change by about σ / c of pixels at c that spread by σ.
    kappa = squared if squared < 1e12 else 1e12 + 1e-6 * pixels.max() / EPS
    return kappa, gap(p @ exact(rays), p @ best)


@kernel("plane fit")
def _plane_fit(t: float, rng: np.random.Generator) -> tuple[float, float]:
    """A table that becomes a narrow strip, at up to 10 km."""
    flat = rng.uniform(-1.0, 1.0, (60, 3)) * [1.0, span(t, 0.8, 0.06), 1e-4]
    points = float32_cloud(flat @ rotation(rng).T + span(t, 1.0, 1e4) * np.array([0.1, -0.2, 1.0]))
    plane = fit_plane(points, PlaneConfig()).plane
    assert plane is not None
    centre, spread = covariance(exact(points))
    values, vectors = eigen(spread)
    normal = vectors[:, 0]
    offset = -(normal @ centre)
    if offset < 0:
        normal, offset = -normal, -offset
    far = float(np.abs(points).max())
    low, middle, high = real(values)
    return high / (middle - low), max(gap(plane.normal, normal), gap(plane.offset, offset) / far)


@kernel("plane fit: rms")
def _plane_rms(t: float, rng: np.random.Generator) -> tuple[float, float]:
    """A table with a vanishing rms, at up to 10 m."""
    turn = rotation(rng) if t < 1.0 else np.eye(3)  # at the end: rms of exactly zero
    flat = rng.uniform(-1.0, 1.0, (60, 3)) * [1.0, 0.8, span(t, 1e-4, 1e-9)]
    flat[:, 2] *= t < 1.0
    points = float32_cloud(flat @ turn.T + span(t, 1.0, 10.0) * np.array([0.1, -0.2, 1.0]))
    _, spread = covariance(exact(points))
    values, _ = eigen(spread)
    size = float(values[2]) ** 0.5
    wanted = mpmath.sqrt(max(values[0], mpmath.mpf(0)))
    return 1.0 + float(np.abs(points).max()) / size, gap(fit_plane(points, PlaneConfig()).rms_m, wanted) / size


@kernel("plane from coefficients")
def _coefficients(t: float, rng: np.random.Generator) -> tuple[float, float]:
    """Coefficients of any scale, down to where squares underflow and up to where they overflow."""
    abcd = rng.normal(size=4) * span(abs(2.0 * t - 1.0), 1.0, 1e280 if t > 0.5 else 1e-280)
    reference = exact(abcd) / norm(exact(abcd[:3]))
    return 1.0, gap(Plane.from_coefficients(abcd).coefficients, reference) / float(np.abs(reference).max())


@kernel("height over the table")
def _height(t: float, rng: np.random.Generator) -> tuple[float, float]:
    """Points at 1.2 m come closer and closer to the table."""
    plane = Plane.from_coefficients([0.1, -0.5, -0.8, 1.0])
    wanted = span(t, 0.5, 1e-6)
    point = float32_cloud([rng.uniform(-0.4, 0.4), rng.uniform(-0.3, 0.3), 0.0])
    point[2] = -(plane.offset - wanted + plane.normal[:2] @ point[:2]) / plane.normal[2]
    terms = exact(plane.normal) * exact(point)
    height = terms.sum() + exact(plane.offset)
    kappa = (np.abs(real(terms)).sum() + abs(plane.offset)) / abs(float(height))
    return kappa, relative_gap(plane.height(point[None])[0], height)


def _far_cloud(t: float, rng: np.random.Generator, n: int = 60) -> tuple[Cloud, Exact, Exact, float]:
    """A cloud of 5 cm at 0.3 m to 10 km, its mean and standard deviation, and κ."""
    points = float32_cloud(
        rng.normal(size=(n, 3)) * [0.05, 0.03, 0.02] + span(t, 0.3, 1e4) * np.array([0.2, -0.3, 1.0])
    )
    mean, spread = covariance(exact(points))
    deviation = sqrt(np.diag(spread))
    return Cloud(points), mean, deviation, float(np.abs(points).max() / real(deviation).min())


@kernel("object identity: grasp")
def _hold(t: float, rng: np.random.Generator) -> tuple[float, float]:
    cloud, mean, deviation, kappa = _far_cloud(t, rng)
    computed = _measure(cloud)
    xyz = exact(cloud.xyz)
    apart = np.abs(xyz - mean).sum(axis=0) / len(xyz)
    return kappa, max(gap(computed[0], mean), gap(computed[1], apart)) / float(min(deviation))


@kernel("object identity: touches")
def _extent(t: float, rng: np.random.Generator) -> tuple[float, float]:
    cloud, mean, deviation, kappa = _far_cloud(t, rng)
    computed = place_and_size(cloud)
    return kappa, gap(computed, np.concatenate([mean, deviation])) / float(min(deviation))


def _near_round(t: float, rng: np.random.Generator) -> tuple[ObjectAxis, Exact, Exact, float]:
    """An object far away, or with two nearly equal eigenvalues: its axis, mean and covariance of its voxels, distance."""
    far, difference = far_or_round(t, rng, 500.0)
    shape = spread_points(rng, 40, [0.1, 0.1 * (1.0 - difference), 0.04]) @ rotation(rng).T
    points = float32_cloud(shape + far * np.array([0.1, 0.1, 1.0]))
    found = find_axis(points, ASSUMED_TABLE, GeoGraspConfig())
    members = [exact(points)[found.grid.cell == k] for k in range(len(found.grid.counts))]
    centre, spread = covariance(np.stack([one.sum(axis=0) / len(one) for one in members]))
    return found, centre, spread, float(np.abs(points).max())


@kernel("object centroid, original")
def _centroid(t: float, rng: np.random.Generator) -> tuple[float, float]:
    found, centre, spread, far = _near_round(t, rng)
    size = float(eigen(spread)[0][2]) ** 0.5
    return far / size, gap(found.centroid, centre) / size


@kernel("object axis, original")
def _axis(t: float, rng: np.random.Generator) -> tuple[float, float]:
    found, _, spread, far = _near_round(t, rng)
    values, vectors = eigen(spread)
    _, middle, high = real(values)
    return (1.0 + far / np.sqrt(high)) * high / (high - middle), gap_up_to_sign(found.direction, vectors[:, 2])


@kernel("voxel cell")
def _voxel_cell(t: float, rng: np.random.Generator) -> tuple[float, float]:
    """Points on both sides of a face, nearer and nearer to it and at up to 10 km."""
    leaf = 0.0125
    face = int(span(t, 3.0, 8e5))
    middle = np.float32((face + 0.5) * leaf)
    steps = np.concatenate([np.arange(-8, 9), rng.integers(-200, 200, 20)])
    near = np.float32(face * leaf) + steps * np.spacing(np.float32(face * leaf))
    xyz = np.zeros((len(near) + 1, 3), np.float32)
    xyz[:, 0] = np.append(near, middle)
    cell = voxel_grid(xyz, leaf).cell
    position = exact(xyz[:-1, 0]) / exact(leaf)
    inside = np.array([mpmath.floor(x) == face for x in position])
    wrong = (cell[:-1] == cell[-1]) != inside
    return face, float(np.abs(position[wrong] - face).max()) if wrong.any() else 0.0


@kernel("neighbour distance")
def _neighbours(t: float, rng: np.random.Generator) -> tuple[float, float]:
    """Clouds of 1e-9 m to 1 km."""
    points = float32_cloud(rng.normal(size=(25, 3)) * span(t, 1e-9, 1e3))
    p = exact(points)
    apart = np.sort(norm(p[:, None] - p[None]), axis=1)[:, 1:6]
    return 1.0, relative_gap(mean_neighbour_distance(points, 5), apart.sum(axis=1) / 5)


def _patches(t: float, rng: np.random.Generator) -> Float64:
    """Two nearly flat, ever narrower patches of 10 mm, up to 0.5 m apart, 0.8 m from the camera."""
    flat = rng.uniform(-1.0, 1.0, (2, 24, 3)) * [0.005, 0.005 * span(t, 0.9, 0.01), 2e-5]
    flat[:, 0] = 0.0
    flat[1, :, 0] += span(t, 0.05, 0.5)
    points = flat.reshape(-1, 3) @ rotation(rng).T + [0.05, -0.1, 0.8]
    return np.asarray(float32_cloud(points).astype(np.float64))


@kernel("normals and curvature")
def _normals(t: float, rng: np.random.Generator) -> tuple[float, float]:
    points = _patches(t, rng)
    normal, curvature = normals_and_curvature(points.astype(np.float32), np.array([0, 24]), 0.02)
    kappa, error = 0.0, 0.0
    for k in range(2):
        mean, spread = covariance(exact(points[24 * k : 24 * (k + 1)]))
        values, vectors = eigen(spread)
        low, middle, high = real(values)
        shift = float(norm(mean - exact(points[0])))
        kappa = max(kappa, (low + middle + high + shift**2) / (middle - low))
        error = max(error, gap_up_to_sign(normal[k], vectors[:, 0]), gap(curvature[k], values[0] / values.sum()))
    return kappa, error


@kernel("unit sphere")
def _unit_sphere(t: float, rng: np.random.Generator) -> tuple[float, float]:
    points = float32_cloud(rng.normal(size=(40, 3)) * 0.05 + span(t, 0.1, 1e4) * np.array([0.2, 0.3, 1.0]))
    frame = UnitSphereFrame.fit(points)
    mean, _ = covariance(exact(points))
    radius = max(norm(exact(points) - mean))
    kappa = float(np.abs(points).max()) / float(radius)
    return kappa, gap(frame.apply_points(points), (exact(points) - mean) / radius)
