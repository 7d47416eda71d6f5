# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest

from foretouch.errors import CloudError, GraspError, TactileError
from foretouch.types import Cloud, Grasp, Plane, Touch


def test_cloud_refuses_another_dtype() -> None:
    with pytest.raises(CloudError, match="float64 is not float32"):
        Cloud(np.zeros((4, 3)))


@pytest.mark.parametrize("shape", [(3,), (4, 2), (2, 2, 2, 3)])
def test_cloud_refuses_another_shape(shape: tuple[int, ...]) -> None:
    with pytest.raises(CloudError, match="neither"):
        Cloud(np.zeros(shape, np.float32))


def test_cloud_refuses_colours_of_other_pixels() -> None:
    with pytest.raises(CloudError, match="is not that of xyz"):
        Cloud(np.zeros((4, 3), np.float32), np.zeros((5, 3), np.uint8))


def test_take_by_mask_equals_take_by_index(rng: np.random.Generator) -> None:
    xyz = rng.normal(size=(6, 5, 3)).astype(np.float32)
    rgb = rng.integers(0, 255, (6, 5, 3), dtype=np.uint8)
    cloud = Cloud(xyz, rgb, "camera", 7)
    mask = xyz[..., 0] > 0
    by_mask, by_index = cloud.take(mask), cloud.take(np.flatnonzero(mask))
    np.testing.assert_array_equal(by_mask.xyz, xyz[mask])
    np.testing.assert_array_equal(by_mask.xyz, by_index.xyz)
    np.testing.assert_array_equal(by_mask.rgb, rgb[mask])
    assert (by_mask.frame_id, by_mask.stamp_ns) == ("camera", 7)


def test_plane_is_normalised_with_its_offset() -> None:
    plane = Plane.from_coefficients([0, 0, 2, -2.5])
    np.testing.assert_allclose(plane.coefficients, [0, 0, 1, -1.25])
    np.testing.assert_allclose(plane.height(np.array([[5.0, 6.0, 1.5]])), [0.25])


@pytest.mark.parametrize("bad", [[0, 0, 0, 1], [0, 0, 1], [0, 0, np.nan, 1]])
def test_plane_refuses_what_is_no_plane(bad: list[float]) -> None:
    with pytest.raises(CloudError, match="plane"):
        Plane.from_coefficients(bad)


@pytest.mark.parametrize("scale", [5e-324, 1e-310, 1e-161, 1e-155, 1e155, 1e200, 3e307])
def test_plane_of_any_scale_is_normalised(scale: float) -> None:
    plane = Plane.from_coefficients(np.array([1.0, -2.0, 2.0, 3.0]) * scale)
    np.testing.assert_allclose(plane.coefficients, np.array([1.0, -2.0, 2.0, 3.0]) / 3.0, rtol=1e-13)


@pytest.mark.parametrize("normal", [1e-10, 1e-200])
def test_plane_refuses_an_offset_that_is_not_finite(normal: float) -> None:
    with pytest.raises(CloudError, match=r"plane: the offset of .* is not finite"):
        Plane.from_coefficients([0.0, 0.0, normal, 1e300])


def test_grasp_midpoint_and_width() -> None:
    grasp = Grasp(np.array([0.0, 0.0, 1.0]), np.array([0.03, 0.04, 1.0]), np.eye(3))
    np.testing.assert_allclose(grasp.midpoint, [0.015, 0.02, 1.0])
    assert grasp.width_m == pytest.approx(0.05)


def test_grasp_refuses_a_contact_that_is_not_finite() -> None:
    with pytest.raises(GraspError, match=r"g2: .* is not finite"):
        Grasp(np.zeros(3), np.array([np.inf, 0, 0]), np.eye(3))


def test_grasp_refuses_zero_width() -> None:
    with pytest.raises(GraspError, match="both contacts"):
        Grasp(np.ones(3), np.ones(3), np.eye(3))


def test_touch_vector_is_thumb_first_and_returns() -> None:
    vector = np.arange(50.0)
    touch = Touch.from_vector(vector)
    assert (touch.pdc_th, touch.pdc_mf) == (0.0, 1.0)
    assert (touch.e_th[0], touch.e_mf[0], touch.e_mf[-1]) == (2.0, 26.0, 49.0)
    np.testing.assert_array_equal(touch.vector(), vector)


def test_touch_refuses_23_electrodes() -> None:
    with pytest.raises(TactileError, match=r"e_th: shape \(23,\)"):
        Touch(1.0, 1.0, np.zeros(23), np.zeros(24))
