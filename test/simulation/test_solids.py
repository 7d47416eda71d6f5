# SPDX-License-Identifier: Apache-2.0
import numpy as np
import numpy.typing as npt
import pytest
from scipy.spatial import cKDTree

from foretouch.simulation.solids import Body, Box, Cylinder, Primitive, Sphere

ROTATION = np.linalg.qr(np.random.default_rng(3).standard_normal((3, 3)))[0]
ROTATION = ROTATION * np.sign(np.linalg.det(ROTATION))
POSITION = np.array([0.1, -0.2, 0.3])
EYE = np.array([0.2, 0.1, 1.5])


def rays(count: int = 4000) -> npt.NDArray[np.float64]:
    towards = POSITION + np.random.default_rng(0).uniform(-0.08, 0.08, (count, 3))
    return (towards - EYE) * 0.7  # of any length


@pytest.mark.parametrize(
    ("shape", "size", "solid", "tolerance_m"),
    [
        ("ball", (0.1, 0.1, 0.1), Sphere(position=POSITION, radius=0.05), 4e-5),
        ("box", (0.1, 0.06, 0.12), Box(position=POSITION, rotation=ROTATION, size=np.array([0.1, 0.06, 0.12])), 1e-6),
    ],
)
def test_rays_meet_a_mesh_where_they_meet_the_solid(
    shape: str, size: tuple[float, ...], solid: Primitive, tolerance_m: float
) -> None:
    directions = rays()
    found = Body(shape, 0, np.array(size), POSITION, ROTATION).cast(EYE, directions).t
    exact = solid.cast(EYE, directions)
    both = np.isfinite(found) & np.isfinite(exact)
    assert both.sum() > 1000
    off = np.abs(found[both] - exact[both]) * np.linalg.norm(directions[both], axis=1)
    assert np.percentile(off, 90) < tolerance_m  # edges are rounded and silhouettes are made of facets
    assert np.mean(np.isfinite(found) != np.isfinite(exact)) < 0.02  # the box is rounded


def test_a_stretched_ball_is_an_ellipsoid() -> None:
    size = np.array([0.06, 0.1, 0.14])
    directions = rays()
    hits = Body("ball", 0, size, POSITION, ROTATION).cast(EYE, directions)
    seen = np.isfinite(hits.t)
    local = (EYE + hits.t[seen, None] * directions[seen] - POSITION) @ ROTATION
    np.testing.assert_allclose(((local / (size / 2)) ** 2).sum(axis=1), 1.0, atol=3e-3)


def test_normals_of_a_stretched_ball_are_its_gradient() -> None:
    size = np.array([0.06, 0.1, 0.14])
    body = Body("ball", 0, size, POSITION, ROTATION)
    directions = rays()
    hits = body.cast(EYE, directions)
    seen = np.isfinite(hits.t)
    local = (EYE + hits.t[seen, None] * directions[seen] - POSITION) @ ROTATION
    gradient = (local / size**2) @ ROTATION.T
    gradient /= np.linalg.norm(gradient, axis=1, keepdims=True)
    normals = body.world_normals(hits.normal[seen])
    assert np.einsum("ij,ij->i", normals, gradient).min() > np.cos(0.05)  # a facet turns by 0.04 rad


def test_origins_may_differ_from_ray_to_ray() -> None:
    body = Body("ball", 0, np.full(3, 0.1), np.zeros(3), np.eye(3))
    starts = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [0.0, 1.0, 1.0]])
    t = body.cast(starts, np.array([[0.0, 0.0, -1.0], [0.0, -2.0, 0.0], [0.0, 0.0, -1.0]])).t
    np.testing.assert_allclose(t, [0.95, 0.475, np.inf], atol=2e-5)


def test_the_lowest_point_of_a_tilted_cylinder() -> None:
    angle = 0.4
    tilt = np.array([[1.0, 0.0, 0.0], [0.0, np.cos(angle), -np.sin(angle)], [0.0, np.sin(angle), np.cos(angle)]])
    can = Body("can", 0, np.array([0.08, 0.08, 0.1]), np.array([0.0, 0.0, 0.5]), tilt)
    solid = Cylinder(position=can.position, rotation=tilt, radius=0.04, height=0.1)
    exact = 0.5 - 0.05 * np.cos(angle) - 0.04 * np.sin(angle)
    assert can.lowest() == pytest.approx(exact, abs=2e-3)  # the rim is bevelled
    assert can.lowest() >= solid.corners()[:, 2].min() - 1e-9


@pytest.mark.parametrize(
    "solid",
    [
        Sphere(position=POSITION, radius=0.05),
        Box(position=POSITION, rotation=ROTATION, size=np.array([0.1, 0.06, 0.12])),
        Cylinder(position=POSITION, rotation=ROTATION, radius=0.04, height=0.11),
    ],
)
def test_the_distance_from_a_solid_is_that_from_its_visible_surface(solid: Primitive) -> None:
    """Of points just in front of the surface; on the surface it is zero, and at the centre the least half extent."""
    directions = rays()
    t = solid.cast(EYE, directions)
    hits = EYE + t[np.isfinite(t), None] * directions[np.isfinite(t)]
    assert np.abs(solid.surface_distance(hits)).max() < 1e-12
    rng = np.random.default_rng(1)
    points = POSITION + rng.uniform(-0.15, 0.15, (200, 3))
    sampled = np.concatenate(
        [
            eye + solid.cast(eye, towards)[:, None] * towards
            for eye in POSITION + 2.0 * np.concatenate([np.eye(3), -np.eye(3)])
            for towards in [POSITION + rng.uniform(-0.08, 0.08, (60_000, 3)) - eye]
        ]
    )
    sampled = sampled[np.isfinite(sampled).all(axis=1)]
    nearest = cKDTree(sampled).query(points)[0]
    found = solid.surface_distance(points)
    assert (found <= nearest + 1e-9).all()
    np.testing.assert_allclose(found, nearest, atol=1.5e-3)
    assert solid.surface_distance(POSITION[None])[0] == pytest.approx(solid.half_extents.min())
