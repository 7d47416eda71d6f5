# SPDX-License-Identifier: Apache-2.0
import numpy as np
from every_case import every_case, every_refusal

from foretouch.cloud.geometry.pixel_grid import PixelGrid, listed_image
from foretouch.errors import CloudError

HEIGHT, WIDTH, FOCAL = 60, 80, 600.0


def _depth_image(rng):
    """A seeded depth image with edges and holes: its points and their pixels."""
    row, column = np.mgrid[:HEIGHT, :WIDTH]
    z = np.where((row // 9 + column // 13) % 2, 1.0, 1.06) + rng.normal(0, 0.001, row.shape)
    xyz = np.stack([(column - 37.3) / FOCAL * z, (row - 200.8) / FOCAL * z, z], axis=-1).astype(np.float32)
    pixels = np.flatnonzero(rng.random(z.size) > 0.15)
    return xyz.reshape(-1, 3)[pixels], pixels


def test_pixels_of_a_shuffled_image_are_recovered(rng):
    xyz, pixels = _depth_image(rng)
    order = rng.permutation(len(xyz))
    grid = PixelGrid.from_rays(xyz[order])
    assert grid is not None
    np.testing.assert_array_equal(grid.row - grid.row.min(), pixels[order] // WIDTH)
    np.testing.assert_array_equal(grid.column, pixels[order] % WIDTH)


def test_clouds_without_pixels_and_pixels_far_apart_make_no_grid_and_no_list_of_pixels_is_refused(rng):
    cases = {
        "off the lattice": rng.uniform(0.5, 1.0, (500, 3)),
        "behind the camera": -_depth_image(rng)[0],
        "next to the lens": [[1, 1, 1], [1, 2, 1e-44], [2, 1, 3]],
        "one place": np.ones((5, 3)),
        "one point": np.ones((1, 3)),
        "no point": np.zeros((0, 3)),
        "a shared ray": [[0, 0, 1], [0, 0, 2], [0, 1, 1]],
    }

    def check(xyz):
        assert PixelGrid.from_rays(np.array(xyz, np.float32)) is None

    every_case(cases, check)
    far = _depth_image(rng)[1].astype(np.int64)
    for last in (65535 * 65536 + 65535, 65535):  # as a message can say it: 4 GB of cells, or one endless row
        far[-1] = last
        assert PixelGrid.from_pixels(far, (65536, 65536)) is None

    cases = [
        ("pixels: an index occurs twice", [3, 4, 3]),
        (r"pixels: 0 \.\.\. 6 is outside of an image of 2x3", [0, 6]),
        ("is not a list of indices", [0.5]),
    ]
    every_refusal(CloudError, cases, lambda pixels: PixelGrid.from_pixels(np.array(pixels), (2, 3)))


def test_the_image_of_a_list_is_recovered_in_any_order_with_holes_of_many_columns_and_rows(rng):
    row, column = np.mgrid[:200, :260]
    z = np.where((row // 9 + column // 13) % 2, 1.0, 1.06) + rng.normal(0, 0.001, row.shape)
    image = np.stack([(column - 137.3) / FOCAL * z, (row - 90.8) / FOCAL * z, z], axis=-1).astype(np.float32)
    image[rng.random(row.shape) < 0.1] = np.nan
    image[40:49] = image[:, 100:113] = np.nan
    image[5, 5] = np.nan
    image[3, 3, 2] = 9.0  # out of range, like the next two: no part of the image, nor a reason against it
    image[3, 4] = -image[3, 4]
    image[3, 5, 0] = np.inf
    expected = image.copy()
    expected[3, 3:6] = np.nan
    flat = image.reshape(-1, 3)
    for order in (np.arange(len(flat)), rng.permutation(len(flat))):
        found = listed_image(flat[order], 0.16, 2.0, 1.7)
        assert found is not None
        np.testing.assert_array_equal(found.xyz, expected)
        place = np.full(len(flat), -1)
        place[order] = np.arange(len(flat))
        place[np.isnan(expected).any(axis=-1).ravel()] = -1
        np.testing.assert_array_equal(found.place, place)
        there = np.isfinite(expected).all(axis=-1).ravel()
        assert (found.n_points, found.connected) == (there.sum(), (there[1:] & there[:-1]).sum())
    assert listed_image(flat, 0.16, 2.0, 0.1) is None  # beyond the tangent
    assert listed_image(np.vstack([flat, flat[:1000]]), 0.16, 2.0, 1.7) is None  # two points of a pixel
    assert listed_image(rng.normal(1.0, 0.1, (20000, 3)).astype(np.float32), 0.16, 2.0, 1.7) is None
