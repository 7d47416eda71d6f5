# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest

from foretouch.cloud.geometry.unit_sphere import UnitSphereFrame
from foretouch.errors import CloudError
from foretouch.types import Grasp


def test_hand_worked_frame() -> None:
    frame = UnitSphereFrame.fit(np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 3.0]], np.float32))
    np.testing.assert_allclose(frame.centre, [0, 0, 2])
    assert frame.scale == pytest.approx(1.0)


def test_points_fill_the_unit_sphere_and_return(rng: np.random.Generator) -> None:
    xyz = rng.normal([0.1, -0.2, 1.2], 0.05, (500, 3)).astype(np.float32)
    frame = UnitSphereFrame.fit(xyz)
    moved = frame.apply_points(xyz)
    np.testing.assert_allclose(moved.mean(axis=0), 0.0, atol=1e-12)
    assert np.linalg.norm(moved, axis=1).max() == pytest.approx(1.0)
    np.testing.assert_allclose(frame.invert_points(moved), xyz, atol=1e-12)


def test_grasp_moves_with_its_cloud(rng: np.random.Generator) -> None:
    xyz = rng.normal(1.0, 0.05, (100, 3)).astype(np.float32)
    rotation = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    grasp = Grasp(xyz[3].astype(np.float64), xyz[70].astype(np.float64), rotation, 1.5, "a", "b")
    frame = UnitSphereFrame.fit(xyz)
    moved = frame.apply_grasp(grasp)
    np.testing.assert_allclose(moved.g1, frame.apply_points(xyz)[3])
    np.testing.assert_allclose(moved.width_m * frame.scale, grasp.width_m)
    np.testing.assert_array_equal(moved.rotation, rotation)
    back = frame.invert_grasp(moved)
    np.testing.assert_allclose([back.g1, back.g2], [grasp.g1, grasp.g2], atol=1e-12)
    assert (back.score, back.id, back.object_id) == (1.5, "a", "b")


def test_a_shift_and_a_scale_change_nothing(rng: np.random.Generator) -> None:
    xyz = rng.normal(0.0, 0.05, (200, 3))
    other = 3.0 * xyz + [0.4, 0.0, 1.0]
    np.testing.assert_allclose(
        UnitSphereFrame.fit(xyz).apply_points(xyz), UnitSphereFrame.fit(other).apply_points(other), atol=1e-12
    )


@pytest.mark.parametrize(
    ("xyz", "message"),
    [
        (np.zeros((0, 3)), "N > 0"),
        (np.ones((5, 3)), "5 points are in one place"),
        (np.array([[0.0, 0, 1], [np.nan, 0, 1]]), "not finite"),
        (np.zeros((5, 2)), r"\(5, 2\)"),
    ],
)
def test_refusals(xyz: np.ndarray, message: str) -> None:
    with pytest.raises(CloudError, match=message):
        UnitSphereFrame.fit(xyz)
