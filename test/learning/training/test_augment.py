# SPDX-License-Identifier: Apache-2.0
"""Turning a cloud with its grasp is the same before and after the preparation of the network's input."""

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose

from foretouch.cloud.geometry.sampling import UnitSphereFrame
from foretouch.learning.training.supervised import turn, viewing_axis_rotations
from foretouch.models.network.preparation import prepare_grasps
from foretouch.types import Grasp


def test_turning_commutes_with_preparation(samples, small, rng) -> None:
    sample = samples[0]
    (rotation,) = viewing_axis_rotations(1, 180.0, rng)
    xyz, grasp = sample.cloud.xyz.astype(np.float64), sample.grasp
    turned = Grasp(rotation @ grasp.g1, rotation @ grasp.g2, rotation @ grasp.rotation)
    frame, other = UnitSphereFrame.fit(xyz), UnitSphereFrame.fit(xyz @ rotation.T)
    points, fed = turn(
        torch.from_numpy(frame.apply_points(xyz))[None],
        torch.from_numpy(prepare_grasps([grasp], frame, small)).double(),
        torch.from_numpy(rotation)[None],
        small,
    )
    assert_allclose(points[0].numpy(), other.apply_points(xyz @ rotation.T), atol=1e-12)
    assert_allclose(fed.numpy(), prepare_grasps([turned], other, small), atol=1e-6)


@pytest.mark.parametrize("channels", ["xyz+rgb", "xyz+normals"])
def test_normals_turn_and_colours_do_not(small, rng, channels: str) -> None:
    rotations = torch.from_numpy(viewing_axis_rotations(2, 90.0, rng))
    points = torch.randn(2, 5, 6, dtype=torch.float64)
    turned, _ = turn(points, torch.zeros(2, 0), rotations, small.replace(channels=channels))
    expected = points[..., 3:] @ rotations.transpose(1, 2) if channels == "xyz+normals" else points[..., 3:]
    assert_allclose(turned[..., 3:].numpy(), expected.numpy())


def test_rotations_are_proper_about_z_and_bounded(rng) -> None:
    rotations = viewing_axis_rotations(200, 20.0, rng)
    assert_allclose(rotations @ rotations.transpose(0, 2, 1), np.tile(np.eye(3), (200, 1, 1)), atol=1e-12)
    assert_allclose(np.linalg.det(rotations), 1.0)
    assert_allclose(rotations[:, 2], [[0, 0, 1]] * 200)
    angles = np.degrees(np.arctan2(rotations[:, 1, 0], rotations[:, 0, 0]))
    assert -20.0 <= angles.min() < -15.0 < 15.0 < angles.max() <= 20.0
