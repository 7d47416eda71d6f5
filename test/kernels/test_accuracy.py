# SPDX-License-Identifier: Apache-2.0
"""Errors of kernels against arithmetic of 40 digits: at most C ε κ, with a condition κ that follows from the input alone.

C is that of `benchmarks/references/kernels.csv`, and ε that of double precision. FORETOUCH_ACCURACY=25x4 takes 25 inputs
between the benign and the hard end of each family, four times each; 3x1 by default.
"""

import os
from collections.abc import Callable, Iterator
from pathlib import Path
from pkgutil import resolve_name

import numpy as np
import pytest
from every_case import every_case
from kernels.references.exact import (
    EPS,
    Exact,
    Float64,
    covariance,
    eigen,
    exact,
    far_or_round,
    float32_cloud,
    gap,
    gap_up_to_sign,
    norm,
    real,
    rotation,
    span,
    spread_points,
)

from benchmarks.common import read_csv
from foretouch.cloud.geometry.pcl_filters import normals_and_curvature
from foretouch.cloud.geometry.sampling import UnitSphereFrame
from foretouch.cloud.segmentation.plane import PlaneConfig, fit_plane
from foretouch.grasp.axis import ObjectAxis, find_axis
from foretouch.grasp.config import GeoGraspConfig
from foretouch.grasp.frame import WeightedPoints, object_frame
from foretouch.grasp.pose import hand_rotation
from foretouch.types import ASSUMED_TABLE, Plane

pytestmark = pytest.mark.committed_numbers

LEVELS, DRAWS = map(int, os.environ.get("FORETOUCH_ACCURACY", "3x1").split("x"))
TABLE = {
    row["kernel"]: row for row in read_csv(Path(__file__).parents[2] / "benchmarks" / "references" / "kernels.csv")
}

Family = Callable[[float, np.random.Generator], tuple[float, float]]
"""From t, 0 for benign and 1 for the hardest input, to κ and the error."""

FAMILIES: dict[str, Family] = {}


def kernel(name: str) -> Callable[[Family], Family]:
    """Add the family of inputs of a kernel of the table."""
    return lambda family: FAMILIES.setdefault(name, family)


def ratios(name: str, family: Family, levels: int, draws: int) -> Iterator[float]:
    """Errors in units of C ε κ; infinite where κ or the error is not a number."""
    for level, t in enumerate(np.linspace(0.0, 1.0, levels)):
        for draw in range(draws):
            condition, error = family(float(t), np.random.default_rng([0, level, draw]))
            value = error / (float(TABLE[name]["C"]) * EPS * condition)
            yield value if value >= 0.0 else float("inf")


def test_errors_are_within_their_bounds() -> None:
    def check(name: str) -> None:
        worst = max(ratios(name, FAMILIES[name], LEVELS, DRAWS))
        print(f"{name:32} worst error / (ε κ) {worst * float(TABLE[name]['C']):.2g}")  # noqa: T201
        assert worst <= 1.0

    assert set(FAMILIES) == {name for name, row in TABLE.items() if row["measured"] == "now"}
    every_case(FAMILIES.keys(), check)
    assert all(float(row["worst"]) <= float(row["C"]) for row in TABLE.values())


def test_the_table_names_functions_that_exist() -> None:
    for row in TABLE.values():
        for name in row["function"].split(", "):
            package = "foretouch_lab" if name.startswith(("learning.", "simulation.")) else "foretouch"
            assert callable(resolve_name(f"{package}.{name}")), row["kernel"]


@kernel("plane fit")
def _plane_fit(t: float, rng: np.random.Generator) -> tuple[float, float]:
    """A table that becomes a narrow strip, at up to 10 km."""
    flat = rng.uniform(-1.0, 1.0, (60, 3)) * [1.0, span(t, 0.8, 0.06), 1e-4]
    points = float32_cloud(flat @ rotation(rng).T + span(t, 1.0, 1e4) * np.array([0.1, -0.2, 1.0]))
    plane, *_ = fit_plane(points, PlaneConfig())
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


def _near_round(t: float, rng: np.random.Generator) -> tuple[ObjectAxis, Exact, Exact, float]:
    """An object far away, or with two nearly equal eigenvalues: its axis, mean and covariance of its voxels, distance."""
    far, difference = far_or_round(t, rng, 500.0)
    shape = spread_points(rng, 40, [0.1, 0.1 * (1.0 - difference), 0.04]) @ rotation(rng).T
    points = float32_cloud(shape + far * np.array([0.1, 0.1, 1.0]))
    found = find_axis(points, ASSUMED_TABLE, GeoGraspConfig())
    members = [exact(points)[found.cells[0] == k] for k in range(len(found.cells[1]))]
    centre, spread = covariance(np.stack([member.sum(axis=0) / len(member) for member in members]))
    return found, centre, spread, float(np.abs(points).max())


@kernel("object axis, original")
def _axis(t: float, rng: np.random.Generator) -> tuple[float, float]:
    found, _, spread, far = _near_round(t, rng)
    values, vectors = eigen(spread)
    _, middle, high = real(values)
    return (1.0 + far / np.sqrt(high)) * high / (high - middle), gap_up_to_sign(found.direction, vectors[:, 2])


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


def _object(t: float, rng: np.random.Generator, n: int = 40) -> WeightedPoints:
    """An object far away, or with two nearly equal eigenvalues."""
    far, difference = far_or_round(t, rng, 1e3)
    shape = spread_points(rng, n, [0.04, 0.04 * (1.0 - difference), 0.01])
    points = shape @ rotation(rng).T + far * np.array([0.1, -0.1, 1.0])
    inlier = rng.uniform(0.2, 1.0, n)
    return WeightedPoints(points, inlier, inlier * rng.uniform(1e-6, 4e-6, n), 0)


@kernel("object frame, completed")
def _frame(t: float, rng: np.random.Generator) -> tuple[float, float]:
    points = _object(t, rng)
    plane = Plane.from_coefficients(np.append(rng.normal(size=3), -1.0))
    _, found = object_frame(points, plane)
    _, spread = covariance(exact(points.xyz), exact(points.area))
    plain, _ = eigen(spread)
    preferred = exact(np.array([0.95, 0.3, 0.08]))
    values, vectors = eigen(spread + exact(0.01) * plain[2] * np.outer(preferred, preferred))
    axis = vectors[:, 2]
    _, middle, high = real(values)
    sign = 1 if found @ real(axis) > 0 else -1  # the rule for it has its own row
    return high / (high - middle), gap(found, sign * axis)


@kernel("rotation of the hand")
def _hand(t: float, rng: np.random.Generator) -> tuple[float, float]:
    """The contacts are more and more in line with the axis; they are 1e-3 to 1e-300 m apart, and so is the axis long."""
    turn = rotation(rng)
    axis = turn[:, 0] * span(t, 1.0, 1e-300)
    between = (turn[:, 0] + span(t, 1.0, 3e-6) * turn[:, 1]) * span(t, 1e-3, 1e-300)
    g2 = rng.normal(size=3) if t == 0.0 else np.zeros(3)
    g1 = g2 + between
    z = (exact(g1) - exact(g2)) / norm(exact(g1) - exact(g2))
    x = np.cross(z, exact(axis) / norm(exact(axis)))
    sine = norm(x)
    x = x / sine
    return 1.0 / float(sine), gap(hand_rotation(g1, g2, axis), np.column_stack([x, np.cross(z, x), z]))
