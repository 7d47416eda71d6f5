# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest

from foretouch.cloud.geometry.pcl_filters import mean_neighbour_distance
from foretouch.cloud.geometry.pixel_window import PixelGrid, window_mean_distance
from foretouch.errors import CloudError

HEIGHT, WIDTH, FOCAL = 60, 80, 600.0


def _depth_image(rng, depth):
    """A seeded depth image with holes: its points and their pixels."""
    row, column = np.mgrid[:HEIGHT, :WIDTH]
    z = depth(row, column) + rng.normal(0, 0.001, row.shape)
    xyz = np.stack([(column - 37.3) / FOCAL * z, (row - 200.8) / FOCAL * z, z], axis=-1).astype(np.float32)
    pixels = np.flatnonzero(rng.random(z.size) > 0.15)
    return xyz.reshape(-1, 3)[pixels], pixels


def _flat(row, column):
    return np.full(row.shape, 1.2)


def _steep(row, column):
    return 1.0 + 0.02 * column


def _edges(row, column):
    return np.where((row // 9 + column // 13) % 2, 1.0, 1.06)


def _thin(row, column):
    return np.where(column % 17 < 3, 0.9, 1.2)


@pytest.mark.parametrize("depth", [_flat, _steep, _edges, _thin])
def test_what_is_proven_is_what_the_tree_finds(depth, rng):
    xyz, pixels = _depth_image(rng, depth)
    grid = PixelGrid.from_pixels(pixels, (HEIGHT, WIDTH))
    mean, proven = window_mean_distance(xyz, grid, 50)
    np.testing.assert_array_equal(mean[proven], mean_neighbour_distance(xyz, 50)[proven])
    if depth is _flat:
        assert proven.mean() > 0.9


@pytest.mark.parametrize("depth", [_flat, _steep, _edges, _thin])
def test_the_pixels_do_not_change_the_distances(depth, rng):
    xyz, pixels = _depth_image(rng, depth)
    grid = PixelGrid.from_pixels(pixels, (HEIGHT, WIDTH))
    np.testing.assert_array_equal(mean_neighbour_distance(xyz, 50, grid), mean_neighbour_distance(xyz, 50))


def test_wrong_pixels_prove_nothing_false(rng):
    xyz, pixels = _depth_image(rng, _flat)
    expected = mean_neighbour_distance(xyz, 50)
    mirrored = (pixels // WIDTH) * WIDTH + WIDTH - 1 - pixels % WIDTH
    for wrong in (rng.permutation(pixels), mirrored, np.arange(len(pixels))):
        grid = PixelGrid.from_pixels(wrong, (HEIGHT, WIDTH))
        mean, proven = window_mean_distance(xyz, grid, 50)
        np.testing.assert_array_equal(mean[proven], expected[proven])


def test_pixels_far_apart_make_no_grid(rng):
    _, pixels = _depth_image(rng, _flat)
    far = pixels.astype(np.int64)
    for last in (65535 * 65536 + 65535, 65535):  # as a message can say it: 4 GB of cells, or one endless row
        far[-1] = last
        assert PixelGrid.from_pixels(far, (65536, 65536)) is None


def test_points_behind_the_camera_prove_nothing(rng):
    xyz, pixels = _depth_image(rng, _flat)
    grid = PixelGrid.from_pixels(pixels, (HEIGHT, WIDTH))
    assert not window_mean_distance(-xyz, grid, 50)[1].any()


def test_more_neighbours_than_the_window_has_pixels_prove_nothing(rng):
    xyz, pixels = _depth_image(rng, _flat)
    grid = PixelGrid.from_pixels(pixels, (HEIGHT, WIDTH))
    assert not window_mean_distance(xyz, grid, 300)[1].any()


def test_pixels_of_a_shuffled_image_are_recovered(rng):
    xyz, pixels = _depth_image(rng, _edges)
    order = rng.permutation(len(xyz))
    grid = PixelGrid.from_rays(xyz[order])
    assert grid is not None
    np.testing.assert_array_equal(grid.row - grid.row.min(), pixels[order] // WIDTH)
    np.testing.assert_array_equal(grid.column, pixels[order] % WIDTH)


def test_a_cloud_off_the_lattice_has_no_pixels(rng):
    assert PixelGrid.from_rays(rng.uniform(0.5, 1.0, (500, 3)).astype(np.float32)) is None


def test_a_cloud_behind_the_camera_has_no_pixels(rng):
    xyz, _ = _depth_image(rng, _flat)
    assert PixelGrid.from_rays(-xyz) is None


@pytest.mark.parametrize("xyz", [np.ones((5, 3)), np.ones((1, 3)), np.zeros((0, 3)), [[0, 0, 1], [0, 0, 2], [0, 1, 1]]])
def test_points_that_share_a_ray_have_no_pixels(xyz):
    assert PixelGrid.from_rays(np.array(xyz, np.float32)) is None


def test_two_points_at_one_pixel_are_refused():
    with pytest.raises(CloudError, match="pixels: an index occurs twice"):
        PixelGrid.from_pixels(np.array([3, 4, 3]), (2, 3))


def test_a_pixel_outside_of_the_image_is_refused():
    with pytest.raises(CloudError, match=r"pixels: 0 \.\.\. 6 is outside of an image of 2x3"):
        PixelGrid.from_pixels(np.array([0, 6]), (2, 3))


def test_pixels_that_are_no_indices_are_refused():
    with pytest.raises(CloudError, match="is no list of indices"):
        PixelGrid.from_pixels(np.array([0.5]), (2, 3))


def test_points_next_to_the_lens_have_no_pixels():
    xyz = np.array([[1, 1, 1], [1, 2, 1e-44], [2, 1, 3]], np.float32)
    assert PixelGrid.from_rays(xyz) is None
