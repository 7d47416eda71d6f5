# SPDX-License-Identifier: Apache-2.0
"""Deprojection against librealsense, with and without distortion, and by hand."""

from itertools import product
from typing import Any

import numpy as np
import pytest
from every_case import every_case, every_refusal

from foretouch.camera.deproject import Deprojector, pinhole_matrix
from foretouch.camera.device import realsense
from foretouch.camera.stream import _lens_of
from foretouch.errors import CameraError, MissingDependencyError


@pytest.fixture(scope="module")
def rs() -> Any:
    try:
        return realsense()
    except MissingDependencyError as err:
        pytest.skip(str(err))


def _intrinsics(rs: Any, model: str, coefficients: list[float]) -> Any:
    i = rs.intrinsics()
    i.width, i.height, i.ppx, i.ppy, i.fx, i.fy = 64, 48, 31.3, 24.2, 50.1, 50.7
    i.model, i.coeffs = getattr(rs.distortion, model), coefficients
    return i


def test_directions_are_those_of_the_library(rs: Any) -> None:
    def check(model: str, coefficients: list[float]) -> None:
        i = _intrinsics(rs, model, coefficients)
        ours = _lens_of(i)
        theirs = np.array([[rs.rs2_deproject_pixel_to_point(i, [u, v], 1.0) for u in range(64)] for v in range(48)])
        # The library computes in float32: coordinates are below 1, ten iterations of a few roundings each.
        np.testing.assert_allclose(ours.x, theirs[..., 0], atol=5e-7)
        np.testing.assert_allclose(ours.y, theirs[..., 1], atol=5e-7)

    models = ("none", "brown_conrady", "inverse_brown_conrady")
    every_case(product(models, ([0.0] * 5, [0.1, -0.05, 0.002, -0.003, 0.02])), check)
    # Distortion is undone by projecting again.
    i = _intrinsics(rs, "inverse_brown_conrady", [0.05, -0.02, 0.001, -0.001, 0.0])
    lens = _lens_of(i)
    pixel = rs.rs2_project_point_to_pixel(i, [float(lens.x[40, 60]), float(lens.y[40, 60]), 1.0])
    np.testing.assert_allclose(pixel, [60.0, 40.0], atol=0.01)
    with pytest.raises(CameraError, match="distortion model kannala_brandt4: cannot be deprojected"):
        _lens_of(_intrinsics(rs, "kannala_brandt4", [0.1, 0.0, 0.0, 0.0, 0.0]))


def test_a_distortion_that_the_iteration_does_not_undo_is_refused() -> None:
    strong = ([-0.3, -0.3, 0.0, 0.0, -0.3], [-2.0, 0.0, 0.0, 0.0, 0.0], [1e300] * 5)
    text, models = r"distortion \[.*\]: is not undone by 10 iterations", ("brown_conrady", "inverse_brown_conrady")
    lens = pinhole_matrix(64, 48), 64, 48
    cases = product([text], strong, models)
    every_refusal(CameraError, cases, lambda coefficients, model: Deprojector.of_lens(*lens, model, coefficients))


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
