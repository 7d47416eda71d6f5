# SPDX-License-Identifier: Apache-2.0
"""Fixed-size sampling and the unit sphere."""

import numpy as np
import pytest
from every_case import every_refusal

from foretouch.cloud.geometry.sampling import UnitSphereFrame, sample_indices
from foretouch.errors import CloudError


def test_points_are_drawn_once_as_long_as_there_are_enough(rng: np.random.Generator) -> None:
    first, again, other = (sample_indices(1200, 750, np.random.default_rng(seed)) for seed in (1, 1, 2))
    assert len(np.unique(first)) == 750
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)
    for size in (1, 7, 750):  # small clouds give all their points
        index = sample_indices(size, 750, rng)
        assert (len(index), set(index.tolist())) == (750, set(range(size)))


def test_what_has_no_sample_or_frame_is_refused(rng: np.random.Generator) -> None:
    for size, n in ((0, 5), (9, 0)):
        with pytest.raises(CloudError, match=f"{n} of {size} points cannot be drawn"):
            sample_indices(size, n, rng)
    frames = [
        ("N > 0", np.zeros((0, 3))),
        ("5 points coincide at", np.ones((5, 3))),
        ("not finite", np.array([[0.0, 0, 1], [np.nan, 0, 1]])),
        (r"1e\+31 m exceeds 1e\+30 m", np.array([[0.0, 0, 1], [1e31, 0, 1]])),
        (r"\(5, 2\)", np.zeros((5, 2))),
    ]
    every_refusal(CloudError, frames, UnitSphereFrame.fit)


def test_points_fill_the_unit_sphere_wherever_they_are(rng: np.random.Generator) -> None:
    xyz = rng.normal([0.1, -0.2, 1.2], 0.05, (500, 3)).astype(np.float32)
    moved = UnitSphereFrame.fit(xyz).apply_points(xyz)
    np.testing.assert_allclose(moved.mean(axis=0), 0.0, atol=1e-12)
    assert np.linalg.norm(moved, axis=1).max() == pytest.approx(1.0)
    other = 3.0 * xyz.astype(np.float64) + [0.4, 0.0, 1.0]
    np.testing.assert_allclose(moved, UnitSphereFrame.fit(other).apply_points(other), atol=1e-12)
    frame = UnitSphereFrame.fit(np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 3.0]], np.float32))
    assert (frame.centre.tolist(), frame.scale) == ([0.0, 0.0, 2.0], 1.0)
