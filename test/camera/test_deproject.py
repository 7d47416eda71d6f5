# SPDX-License-Identifier: Apache-2.0
"""Deprojection against librealsense, and by hand."""

from typing import Any

import numpy as np
import pytest

from foretouch.camera.deproject import Deprojector
from foretouch.camera.device import realsense
from foretouch.camera.stream import _lens_of
from foretouch.errors import CameraError, MissingDependencyError


@pytest.fixture(scope="module")
def rs() -> Any:
    try:
        return realsense()
    except MissingDependencyError as err:
        pytest.skip(str(err))


def test_directions_are_those_of_the_library_and_distortion_is_refused(rs: Any) -> None:
    i = rs.intrinsics()
    i.width, i.height, i.ppx, i.ppy, i.fx, i.fy = 64, 48, 31.3, 24.2, 50.1, 50.7
    i.model, i.coeffs = rs.distortion.brown_conrady, [0.0] * 5
    ours = _lens_of(i)
    theirs = np.array([[rs.rs2_deproject_pixel_to_point(i, [u, v], 1.0) for u in range(64)] for v in range(48)])
    # The library computes in float32: coordinates are below 1.
    np.testing.assert_allclose(ours.x, theirs[..., 0], atol=5e-7)
    np.testing.assert_allclose(ours.y, theirs[..., 1], atol=5e-7)
    i.coeffs = [0.1, 0.0, 0.0, 0.0, 0.0]
    with pytest.raises(CameraError, match="only rectified images are supported"):
        _lens_of(i)


def test_a_pixel_by_hand() -> None:
    matrix = np.array([[100.0, 0.0, 2.0], [0.0, 50.0, 1.0], [0.0, 0.0, 1.0]])
    depth = np.zeros((3, 5), np.uint16)
    depth[2, 4] = 500
    lens = Deprojector.of_lens(matrix, 5, 3)
    xyz = lens.points(depth)
    np.testing.assert_allclose(xyz[2, 4], [0.01, 0.01, 0.5], rtol=1e-6)
    assert np.isnan(xyz).all(axis=-1).sum() == 14
    np.testing.assert_allclose(lens.points(depth, 0.0001)[2, 4], xyz[2, 4] / 10.0, rtol=1e-6)
    with pytest.raises(CameraError, match=r"depth image: shape \(4, 5\) is not the lens's \(3, 5\)"):
        lens.points(np.zeros((4, 5), np.uint16))
