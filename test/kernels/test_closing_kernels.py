# SPDX-License-Identifier: Apache-2.0
"""The lines along which two fingers close, by hand; what plans do with them is in `test/grasp/test_completed.py`."""

import numpy as np

from foretouch.grasp import completed


def test_an_ideal_box_is_as_wide_as_it_is() -> None:
    """A block of points that is filled from 0 to 80 mm: worked by hand."""
    axis = np.arange(-0.03, 0.0301, 0.001)
    x, y, z = np.meshgrid(axis + 0.0002, np.arange(-0.02, 0.0201, 0.001) + 0.0002, np.arange(0.001, 0.08, 0.002))
    points = np.stack([x, y, z], axis=-1).reshape(-1, 3)
    settings = np.array([0.004, 0.008, 0.01, 0.001, 1.0, 0.0, 0.038])
    turns = np.array([[0.0, 0.0, np.nan], [np.pi / 2.0, 0.0, np.nan], [0.0, 0.004, np.nan]])
    others = np.array([[0.05, 0.0, 0.04], [0.0, -0.03, 0.04], [0.08, 0.0, 0.04], [0.05, 0.0, 0.02]])
    found = np.empty((3, 3, 6))
    completed._closing_lines(
        *(points, np.ones(len(points)), len(points), turns, 3, 3, settings, np.zeros(15)),
        *(np.zeros((1, 1), np.float32), np.zeros((1, 1), np.float32), 0, 0, others, len(others), found),
    )
    np.testing.assert_allclose(found[0, :, 0], -0.0298, atol=0.0006)
    np.testing.assert_allclose(found[0, :, 1], 0.0302, atol=0.0006)
    np.testing.assert_allclose(found[1, :, 0], -0.0198, atol=0.0006)
    np.testing.assert_allclose(found[1, :, 1], 0.0202, atol=0.0006)
    np.testing.assert_allclose(found[:, :, 3], 0.076, atol=0.002)  # 95 % of the points are lower
    np.testing.assert_allclose(found[:, :, 2], found[:, :, 3] / 2.0, atol=1e-9)
    np.testing.assert_array_equal(
        found[0, :, 4], 0
    )  # the first, 20 mm outside of the end and no more than a tip beside
    np.testing.assert_array_equal(found[1, 1:, 4], 1)
    np.testing.assert_array_equal(found[:, :, 5], 1.0)  # without a view nothing is seen through
    np.testing.assert_allclose(found[2, 0], found[0, 1], atol=1e-8)  # moved by one step: the same line
