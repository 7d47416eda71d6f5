# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest
from every_case import every_case

from foretouch.errors import SimulationError
from foretouch_lab.simulation.objects import SHAPES, shapes, unit_mesh

MEMBERS = [(shape, 0) for shape in SHAPES] + [("random", k) for k in range(1, 12)]


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
        assert 0.2 < mesh.volume() < 1.0

    every_case(MEMBERS, check)


def test_volumes_of_known_solids_and_members_of_the_family_differ_and_come_back() -> None:
    sphere = shapes._star_shaped(np.full(len(shapes._sphere_directions()), 0.05))
    assert sphere.volume() == pytest.approx(4.0 / 3.0 * np.pi * 0.05**3, rel=2e-3)
    half_disc = np.linspace(0.0, np.pi, 65)
    turned = shapes._revolved(np.stack([0.05 * np.sin(half_disc), -0.05 * np.cos(half_disc)], axis=1))
    assert turned.volume() == pytest.approx(4.0 / 3.0 * np.pi * 0.05**3, rel=2e-3)
    box = shapes._rounded_box((0.1, 0.2, 0.3), 0.001)
    assert box.volume() == pytest.approx(0.006, rel=1e-3)
    np.testing.assert_allclose(box.extents, [0.1, 0.2, 0.3])
    volumes = {round(unit_mesh("random", k).volume(), 6) for k in range(12)}
    assert len(volumes) == 12
    unit_mesh.cache_clear()
    assert {round(unit_mesh("random", k).volume(), 6) for k in range(12)} == volumes
    with pytest.raises(SimulationError, match=r"'cube' is not one of ball, box, can"):
        unit_mesh("cube")
