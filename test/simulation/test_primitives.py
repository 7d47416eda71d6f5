# SPDX-License-Identifier: Apache-2.0
"""Rays against closed forms and against Open3D's ray caster."""

from __future__ import annotations

import numpy as np
import pytest

from foretouch.libusb import ensure_libusb
from foretouch.simulation import Box, Cylinder, Primitive, Sphere

_QUARTER = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])  # z along x


def _rotation(rng: np.random.Generator) -> np.ndarray:
    q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    return q * np.sign(np.linalg.det(q))


def _rays(rng: np.random.Generator, n: int = 20000) -> tuple[np.ndarray, np.ndarray]:
    """An eye 1 m off and rays of any length around the origin."""
    eye = np.array([0.3, -0.7, 0.6])
    return eye, (rng.uniform(-0.15, 0.15, (n, 3)) - eye) * rng.uniform(0.3, 3.0, (n, 1))


def test_the_axis_of_a_ball_is_met_one_radius_before_its_centre() -> None:
    ball = Sphere(position=np.array([0.0, 0.0, 1.0]), radius=0.1)
    t = ball.cast(np.zeros(3), np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 0.5], [0.0, 0.2, 1.0]]))
    np.testing.assert_allclose(t, [0.9, 1.8, np.inf], rtol=1e-15)


@pytest.mark.parametrize("direction", [[0.0, 0.0, 1.0], [1e-17, 0.0, 1.0]])
def test_parallel_to_the_axis_of_a_cylinder_only_its_cap_counts(direction: list[float]) -> None:
    can = Cylinder(position=np.array([0.0, 0.0, 1.0]), radius=0.05, height=0.2)
    eyes = [np.array([0.04, 0.0, 0.0]), np.array([0.06, 0.0, 0.0])]
    hits = [float(can.cast(eye, np.array(direction))) for eye in eyes]
    np.testing.assert_allclose(hits, [0.9, np.inf], rtol=1e-12)


def test_a_lying_cylinder_is_met_on_its_mantle() -> None:
    can = Cylinder(position=np.array([0.0, 0.0, 1.0]), rotation=_QUARTER, radius=0.05, height=0.2)
    t = can.cast(np.zeros(3), np.array([[0.0, 0.0, 1.0], [0.09, 0.0, 1.0], [0.12, 0.0, 1.0]]))
    np.testing.assert_allclose(t[:2], [0.95, 0.95], rtol=1e-12)
    assert t[2] == np.inf


def test_a_ray_along_a_face_of_a_box_is_in_or_out_but_never_nan() -> None:
    box = Box(position=np.array([0.0, 0.0, 1.0]), size=np.array([0.2, 0.2, 0.2]))
    for x, expected in ((0.0, 0.9), (0.1, 0.9), (0.1000001, np.inf)):
        assert float(box.cast(np.array([x, 0.0, 0.0]), np.array([0.0, 0.0, 1.0]))) == pytest.approx(expected)


def test_a_solid_behind_the_eye_is_not_seen() -> None:
    ball = Sphere(position=np.array([0.0, 0.0, -1.0]), radius=0.1)
    assert np.isinf(ball.cast(np.zeros(3), np.array([0.0, 0.0, 1.0])))


@pytest.mark.parametrize("kind", ["box", "cylinder", "sphere"])
def test_hits_agree_with_open3d(kind: str, rng: np.random.Generator) -> None:
    ensure_libusb()
    import open3d as o3d

    position, rotation = np.array([0.02, -0.01, 0.03]), _rotation(rng)
    pose: dict[str, np.ndarray] = {"position": position, "rotation": rotation}
    solid: Primitive
    if kind == "box":
        solid, tolerance = Box(size=np.array([0.1, 0.06, 0.14]), **pose), 1e-5
        mesh = o3d.geometry.TriangleMesh.create_box(0.1, 0.06, 0.14).translate((-0.05, -0.03, -0.07))
    elif kind == "cylinder":
        solid, tolerance = Cylinder(radius=0.04, height=0.15, **pose), 1e-3
        mesh = o3d.geometry.TriangleMesh.create_cylinder(0.04, 0.15, resolution=400, split=1)
    else:
        solid, tolerance = Sphere(radius=0.07, **pose), 1e-3
        mesh = o3d.geometry.TriangleMesh.create_sphere(0.07, resolution=200)
    mesh.rotate(rotation, (0.0, 0.0, 0.0)).translate(position)
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(o3d.t.geometry.TriangleMesh.from_legacy(mesh))
    eye, directions = _rays(rng)
    rays = np.hstack([np.broadcast_to(eye, directions.shape), directions]).astype(np.float32)
    theirs = scene.cast_rays(o3d.core.Tensor(rays))["t_hit"].numpy()
    ours = solid.cast(eye, directions)

    both = np.isfinite(ours) & np.isfinite(theirs)
    assert both.sum() > 2000
    assert (np.isfinite(ours) != np.isfinite(theirs)).mean() < 2e-3  # silhouettes: facets against the true curve
    reach = np.linalg.norm(directions, axis=1)
    error = np.abs(ours[both] - theirs[both]) * reach[both]
    assert np.quantile(error, 0.99) < tolerance  # grazing rays stretch a facet's sagitta


def test_moving_a_solid_and_the_eye_together_changes_nothing(rng: np.random.Generator) -> None:
    can = Cylinder(position=np.zeros(3), rotation=_rotation(rng), radius=0.04, height=0.15)
    eye, directions = _rays(rng, 500)
    offset = np.array([0.3, 0.2, -0.1])
    np.testing.assert_allclose(
        can.moved(offset).cast(eye + offset, directions), can.cast(eye, directions), rtol=1e-9, atol=0.0
    )


def test_corners_and_footprint_of_a_box() -> None:
    box = Box(position=np.array([1.0, 2.0, 3.0]), size=np.array([0.6, 0.8, 1.0]))
    assert box.footprint_m() == pytest.approx(0.5)
    np.testing.assert_allclose(box.corners().min(axis=0), [0.7, 1.6, 2.5])
    np.testing.assert_allclose(box.corners().max(axis=0), [1.3, 2.4, 3.5])
