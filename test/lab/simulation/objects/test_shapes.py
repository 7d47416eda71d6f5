# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest
from every_case import every_case

from foretouch_lab.simulation.objects import SHAPES, TriangleMesh, shapes, unit_mesh

MEMBERS = [(shape, 0) for shape in SHAPES] + [("random", k) for k in range(1, 12)]


def volume(mesh: TriangleMesh) -> float:
    """Enclosed volume by the divergence theorem."""
    a, b, c = (mesh.vertices[mesh.faces[:, i]] for i in range(3))
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum()) / 6.0


def test_a_unit_mesh_is_closed_in_one_piece_and_fills_its_box() -> None:
    def check(shape: str, variant: int) -> None:
        mesh = unit_mesh(shape, variant)
        faces = mesh.faces
        edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
        shared, times = np.unique(np.sort(edges, axis=1) @ [len(mesh.vertices), 1], return_counts=True)
        assert (times == 2).all()
        assert len(mesh.vertices) - len(shared) + len(faces) == 2  # Euler: a sphere's topology
        assert len(np.unique(faces)) == len(mesh.vertices)  # no vertex without a face
        np.testing.assert_allclose([mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)], [[-0.5] * 3, [0.5] * 3])
        assert 0.2 < volume(mesh) < 1.0

    every_case(MEMBERS, check)
    assert len({round(volume(unit_mesh("random", k)), 6) for k in range(12)}) == 12


def test_volumes_and_the_centre_of_known_solids() -> None:
    sphere = shapes._star_shaped(np.full(len(shapes._sphere_directions()), 0.05))
    half_disc = np.linspace(0.0, np.pi, 65)
    turned = shapes._revolved(np.stack([0.05 * np.sin(half_disc), -0.05 * np.cos(half_disc)], axis=1))
    for mesh in (sphere, turned):
        assert volume(mesh) == pytest.approx(4.0 / 3.0 * np.pi * 0.05**3, rel=2e-3)
    assert volume(shapes._rounded_box(0.001)) == pytest.approx(1.0, rel=1e-3)
    moved = TriangleMesh(sphere.vertices + np.array([0.1, 0.2, 0.3]), sphere.faces)
    np.testing.assert_allclose(moved.centroid, [0.1, 0.2, 0.3], atol=1e-6)
