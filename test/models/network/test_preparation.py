# SPDX-License-Identifier: Apache-2.0
"""What the network is fed: frame, channels, and refusals."""

import numpy as np
import pytest
from every_case import every_refusal
from numpy.testing import assert_allclose

from foretouch.errors import CloudError, ModelError
from foretouch.models.network.preparation import prepare_cloud, prepare_grasps
from foretouch.types import Cloud


def test_points_lie_in_the_unit_sphere_and_grasps_move_with_them(can, small, make_grasps) -> None:
    grasps = make_grasps(3)
    prepared = prepare_cloud(can, small)
    assert (prepared.points.shape, prepared.points.dtype) == ((64, 3), np.float32)
    assert np.linalg.norm(prepared.points, axis=1).max() <= 1.0 + 1e-6
    fed = prepare_grasps(grasps, prepared.frame, small)
    assert fed.shape == (3, 15)
    for row, grasp in zip(fed, grasps, strict=True):
        back = row[:6].reshape(2, 3).astype(np.float64) * prepared.frame.scale + prepared.frame.centre
        assert_allclose(back, [grasp.g1, grasp.g2], atol=1e-7)
        assert_allclose(row[6:15], grasp.rotation.ravel())


def test_shift_and_size_vanish_but_for_the_metric_inputs(can, small, make_grasps) -> None:
    config = small.replace(metric_inputs=True)
    (grasp,) = make_grasps(1)
    shift = np.array([0.25, -0.5, 0.125])
    bigger = Cloud((can.xyz * 2 + shift).astype(np.float32), can.rgb)
    moved = type(grasp)(grasp.g1 * 2 + shift, grasp.g2 * 2 + shift, grasp.rotation)
    one, two = prepare_cloud(can, config), prepare_cloud(bigger, config)
    assert_allclose(two.points, one.points, atol=2e-5)
    a, b = prepare_grasps([grasp], one.frame, config)[0], prepare_grasps([moved], two.frame, config)[0]
    assert_allclose(b[:15], a[:15], atol=2e-5)
    assert_allclose(b[15:], 2 * a[15:], rtol=1e-5)
    assert a[16] == pytest.approx(0.66)  # a width of 66 mm in dm


def test_channels_of_a_cloud_are_one_input_without_the_points_that_have_no_depth(can, small) -> None:
    colour = prepare_cloud(can, small.replace(channels="xyz+rgb")).points
    assert colour.shape == (64, 6)
    assert colour[:, 3:].min() >= -1.0
    assert colour[:, 3:].max() <= 1.0
    normal = prepare_cloud(can, small.replace(channels="xyz+normals")).points
    assert_allclose(np.linalg.norm(normal[:, 3:], axis=1), 1.0, atol=1e-5)
    assert_allclose(normal[:, :3], colour[:, :3])
    assert np.array_equal(prepare_cloud(can, small).points, prepare_cloud(can, small).points)
    holes = Cloud(np.concatenate([can.xyz, np.full((100, 3), np.nan, np.float32)]))
    assert np.array_equal(prepare_cloud(holes, small).points, prepare_cloud(Cloud(can.xyz), small).points)


def test_unusable_clouds_and_missing_colour_are_named(can, small) -> None:
    cases = (
        ("0 finite points of 0 are fewer than 32", np.empty((0, 3))),
        ("0 finite points of 50", np.full((50, 3), np.nan)),
        ("0 finite points of 50", np.full((50, 3), np.inf)),
        ("all 50 finite points are in one place", np.ones((50, 3))),
    )
    every_refusal(CloudError, cases, lambda xyz: prepare_cloud(Cloud(xyz.astype(np.float32)), small))
    with pytest.raises(ModelError, match=r"needs xyz\+rgb and the cloud has no rgb"):
        prepare_cloud(Cloud(can.xyz), small.replace(channels="xyz+rgb"))
