# SPDX-License-Identifier: Apache-2.0
"""Points beside the ray of their pixel or out of view: dropped and counted before they decide on anything."""

import warnings

import numpy as np
import numpy.typing as npt
import pytest

from foretouch.cloud.segmentation.plane import fit_plane
from foretouch.cloud.segmentation.rays import RayConfig, RayFilter
from foretouch.cloud.segmentation.segment import Segmentation, SegmentationConfig, _coarse, _sample, segment
from foretouch.simulation.depth_scene import random_scene
from foretouch.types import Cloud

Float32 = npt.NDArray[np.float32]


def _scene(seed: int = 3, n_objects: int = 3) -> Float32:
    rng = np.random.default_rng(seed)
    return random_scene(rng, n_objects=n_objects).render(rng, 0.001).cloud().xyz


def _strictly(cloud: Cloud) -> Segmentation:
    with warnings.catch_warnings(), np.errstate(all="raise", under="ignore", invalid="ignore"):
        warnings.simplefilter("error")
        found = segment(cloud)
    counts = found.counts
    parts = ("not_finite", "out_of_range", "off_ray", "background", "rejected", "flying", "objects")
    assert counts["received"] == cloud.size == sum(counts[name] for name in parts)
    return found


@pytest.mark.parametrize("value", [1e20, -1e30, 3e38, 50.0])
@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("organised", [True, False])
def test_one_damaged_coordinate_does_not_move_the_table(value: float, axis: int, organised: bool) -> None:
    xyz = _scene()
    if not organised:
        xyz = xyz.reshape(-1, 3)[np.isfinite(xyz[..., 2].reshape(-1))]
    expected = _strictly(Cloud(xyz)).plane.coefficients
    index = np.argwhere((xyz[..., 2] > 0.2) & (xyz[..., 2] < 2.0))
    for chosen in index[:: len(index) // 20]:
        damaged = xyz.copy()
        damaged[(*chosen, axis)] = value
        found = _strictly(Cloud(damaged))
        assert found.status == "ok"
        np.testing.assert_allclose(found.plane.coefficients, expected, atol=1e-3)


@pytest.mark.parametrize("value", [1e20, -1e30, 3e38])
@pytest.mark.parametrize("axis", [0, 1])
def test_a_damaged_pixel_that_the_plane_fit_samples_does_not_turn_the_table(value: float, axis: int) -> None:
    xyz = _scene()
    config = SegmentationConfig()
    coarse, stride, in_range = _coarse(xyz, config.crop, config.grid_rows)
    sampled = _sample(in_range)
    expected = _strictly(Cloud(xyz)).plane
    for index in sampled[:: len(sampled) // 10]:
        row, column = (stride * int(i) for i in np.divmod(index, coarse.shape[1]))
        damaged = xyz.copy()
        damaged[row, column, axis] = value
        found = _strictly(Cloud(damaged))
        assert (found.status, found.counts["off_ray"]) == ("ok", 1)
        np.testing.assert_allclose(found.plane.coefficients, expected.coefficients, atol=1e-3)
        points = np.ascontiguousarray(damaged[::stride, ::stride]).reshape(-1, 3)[sampled]
        with np.errstate(all="ignore"):
            unchecked = fit_plane(points, config.plane).plane  # the fit itself does not withstand such a point
        assert unchecked is None or abs(unchecked.normal @ expected.normal) < 0.99


def test_every_damaged_pixel_of_the_sample_and_of_the_objects_is_counted() -> None:
    xyz = _scene()
    whole = segment(Cloud(xyz))
    pixels = np.concatenate([one.pixels[::50] for one in whole.objects])
    damaged = xyz.copy()
    damaged.reshape(-1, 3)[pixels, 0] = 1e25
    found = _strictly(Cloud(damaged))
    assert found.counts["off_ray"] == len(pixels)
    assert len(found.objects) == len(whole.objects)
    assert not np.isin(np.concatenate([one.pixels for one in found.objects]), pixels).any()
    assert max(np.abs(one.cloud.xyz).max() for one in found.objects) < 3.0


def test_a_flat_cloud_with_one_damaged_pixel_is_a_table() -> None:
    columns, rows = np.meshgrid(np.linspace(-0.4, 0.4, 212), np.linspace(-0.3, 0.3, 120))
    xyz = np.stack([columns, rows, np.ones_like(rows)], axis=-1).astype(np.float32)
    xyz[60, 100, 0] = 1e20
    found = _strictly(Cloud(xyz))
    assert found.status == "no_object"
    np.testing.assert_allclose(found.plane.coefficients, [0.0, 0.0, -1.0, 1.0], atol=1e-6)


@pytest.mark.parametrize("share", [0.05, 0.3])
def test_a_share_of_damaged_pixels_leaves_the_rays_and_the_table(share: float, rng: np.random.Generator) -> None:
    xyz = _scene()
    expected = segment(Cloud(xyz)).plane.coefficients
    bad = rng.random(xyz.shape[:2]) < share
    xyz[bad, rng.integers(0, 2, bad.sum())] = 10.0 ** rng.uniform(1, 38, bad.sum())
    found = _strictly(Cloud(xyz))
    assert found.plane is not None
    np.testing.assert_allclose(found.plane.coefficients, expected, atol=3e-3)
    assert found.counts["off_ray"] > 100


def test_an_image_whose_points_are_not_on_rays_is_refused(rng: np.random.Generator) -> None:
    xyz = _scene()
    shuffled = rng.permutation(xyz.reshape(-1, 3)).reshape(xyz.shape)
    found = _strictly(Cloud(shuffled))
    assert found.status == "bad_cloud"
    assert "beside the rays of their pixels" in found.reason


def test_lateral_coordinates_in_millimetres_are_refused() -> None:
    xyz = _scene() * np.array([1000.0, 1000.0, 1.0], np.float32)
    found = _strictly(Cloud(xyz))
    assert (found.status, "field_of_view_deg 120" in found.reason) == ("bad_cloud", True)
    keep = np.isfinite(xyz[..., 2])
    found = _strictly(Cloud(xyz[keep]))
    assert (found.status, "field of view of 120" in found.reason) == ("bad_cloud", True)


def test_a_rotated_image_is_on_rays() -> None:
    turned = np.rot90(_scene(), axes=(0, 1))
    found = _strictly(Cloud(np.ascontiguousarray(turned)))
    assert found.status == "ok"
    assert found.counts["off_ray"] == 0


def test_pixels_on_one_line_do_not_matter() -> None:
    columns = np.arange(5)
    sample = np.stack([columns * 0.1, columns * 0.0, np.ones(5)], axis=1).astype(np.float32)
    rays = RayFilter(sample, np.zeros(5, np.intp), columns.astype(np.intp), RayConfig())
    assert rays.reason == ""
    assert not rays.off_sample.any()


def test_the_tolerance_is_a_setting() -> None:
    xyz = _scene()
    pixels = segment(Cloud(xyz)).objects[0].pixels[::10]
    xyz.reshape(-1, 3)[pixels, 0] += 0.03
    assert segment(Cloud(xyz)).counts["off_ray"] == 0
    strict = SegmentationConfig(rays=RayConfig(max_deviation=0.01))
    assert segment(Cloud(xyz), strict).counts["off_ray"] == len(pixels)
