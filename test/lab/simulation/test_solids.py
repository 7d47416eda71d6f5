# SPDX-License-Identifier: Apache-2.0
"""Rays against closed forms, meshes against solids, and solids against Open3D's ray caster."""

import numpy as np
import pytest
from every_case import every_case

from foretouch.camera.device import ensure_libusb
from foretouch_lab.simulation.solids import Body, Box, Cylinder, Sphere

POSITION = np.array([0.1, -0.2, 0.3])
EYE = np.array([0.2, 0.1, 1.5])
_QUARTER = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])  # z along x


@pytest.fixture
def turn(rng):
    q = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    return q * np.sign(np.linalg.det(q))


@pytest.fixture
def solids(turn):
    return {
        "sphere": Sphere(position=POSITION, radius=0.05),
        "box": Box(position=POSITION, rotation=turn, size=np.array([0.1, 0.06, 0.12])),
        "cylinder": Cylinder(position=POSITION, rotation=turn, radius=0.04, height=0.11),
    }


def rays(rng, count=4000):
    """Of any length, towards the solids."""
    return (POSITION + rng.uniform(-0.08, 0.08, (count, 3)) - EYE) * rng.uniform(0.3, 3.0, (count, 1))


def test_rays_meet_solids_where_a_hand_calculation_says_from_any_origin():
    ball = Sphere(position=np.array([0.0, 0.0, 1.0]), radius=0.1)
    t = ball.cast(np.zeros(3), np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 0.5], [0.0, 0.2, 1.0], [0.0, 0.0, -1.0]]))
    np.testing.assert_allclose(t, [0.9, 1.8, np.inf, np.inf], rtol=1e-15)
    lying = Cylinder(position=np.array([0.0, 0.0, 1.0]), rotation=_QUARTER, radius=0.05, height=0.2)
    t = lying.cast(np.zeros(3), np.array([[0.0, 0.0, 1.0], [0.09, 0.0, 1.0], [0.12, 0.0, 1.0]]))
    np.testing.assert_allclose(t, [0.95, 0.95, np.inf], rtol=1e-12)
    can = Cylinder(position=np.array([0.0, 0.0, 1.0]), radius=0.05, height=0.2)
    for direction in ([0.0, 0.0, 1.0], [1e-17, 0.0, 1.0]):  # parallel to the axis only the cap counts
        hits = [float(can.cast(np.array([x, 0.0, 0.0]), np.array(direction))) for x in (0.04, 0.06)]
        np.testing.assert_allclose(hits, [0.9, np.inf], rtol=1e-12)
    box = Box(position=np.array([0.0, 0.0, 1.0]), size=np.array([0.2, 0.2, 0.2]))
    for x, expected in ((0.0, 0.9), (0.1, 0.9), (0.1000001, np.inf)):  # along a face: in or out, never NaN
        assert float(box.cast(np.array([x, 0.0, 0.0]), np.array([0.0, 0.0, 1.0]))) == pytest.approx(expected)
    body = Body("ball", 0, np.full(3, 0.1), np.zeros(3), np.eye(3))
    starts = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [0.0, 1.0, 1.0]])
    t = body.cast(starts, np.array([[0.0, 0.0, -1.0], [0.0, -2.0, 0.0], [0.0, 0.0, -1.0]])).t
    np.testing.assert_allclose(t, [0.95, 0.475, np.inf], atol=2e-5)


def test_a_stretched_ball_is_an_ellipsoid_with_its_gradient_as_normals(turn, rng):
    size = np.array([0.06, 0.1, 0.14])
    body, directions = Body("ball", 0, size, POSITION, turn), rays(rng)
    hits = body.cast(EYE, directions)
    seen = np.isfinite(hits.t)
    local = (EYE + hits.t[seen, None] * directions[seen] - POSITION) @ turn
    np.testing.assert_allclose(((local / (size / 2)) ** 2).sum(axis=1), 1.0, atol=3e-3)
    gradient = (local / size**2) @ turn.T
    gradient /= np.linalg.norm(gradient, axis=1, keepdims=True)
    normals = body.world_normals(hits.normal[seen])
    assert np.einsum("ij,ij->i", normals, gradient).min() > np.cos(0.05)  # a facet turns by 0.04 rad


def test_the_lowest_point_of_a_tilted_cylinder():
    angle = 0.4
    tilt = np.array([[1.0, 0.0, 0.0], [0.0, np.cos(angle), -np.sin(angle)], [0.0, np.sin(angle), np.cos(angle)]])
    can = Body("can", 0, np.array([0.08, 0.08, 0.1]), np.array([0.0, 0.0, 0.5]), tilt)
    solid = Cylinder(position=can.position, rotation=tilt, radius=0.04, height=0.1)
    exact = 0.5 - 0.05 * np.cos(angle) - 0.04 * np.sin(angle)
    assert can.lowest() == pytest.approx(exact, abs=2e-3)  # the rim is bevelled
    assert can.lowest() >= solid.corners()[:, 2].min() - 1e-9


def test_hits_agree_with_open3d(solids, turn, rng):
    ensure_libusb()
    import open3d as o3d

    make = o3d.geometry.TriangleMesh
    meshes = {
        "box": (make.create_box(0.1, 0.06, 0.12).translate((-0.05, -0.03, -0.06)), 1e-5),
        "cylinder": (make.create_cylinder(0.04, 0.11, resolution=400, split=1), 1e-3),
        "sphere": (make.create_sphere(0.05, resolution=200), 1e-3),
    }
    directions = rays(rng, 20_000)

    def check(name, solid):
        mesh, tolerance = meshes[name]
        mesh.rotate(turn, (0.0, 0.0, 0.0)).translate(POSITION)
        scene = o3d.t.geometry.RaycastingScene()
        scene.add_triangles(o3d.t.geometry.TriangleMesh.from_legacy(mesh))
        both_ends = np.hstack([np.broadcast_to(EYE, directions.shape), directions]).astype(np.float32)
        theirs = scene.cast_rays(o3d.core.Tensor(both_ends))["t_hit"].numpy()
        ours = solid.cast(EYE, directions)
        both = np.isfinite(ours) & np.isfinite(theirs)
        assert both.sum() > 2000
        assert (np.isfinite(ours) != np.isfinite(theirs)).mean() < 3e-3  # silhouettes: facets against the true curve
        error = np.abs(ours[both] - theirs[both]) * np.linalg.norm(directions[both], axis=1)
        assert np.quantile(error, 0.99) < tolerance  # grazing rays stretch a facet's sagitta

    every_case(list(solids.items()), check)
