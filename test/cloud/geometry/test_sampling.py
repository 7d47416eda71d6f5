# SPDX-License-Identifier: Apache-2.0
"""Fixed-size sampling and the unit sphere."""

import numpy as np
import pytest
from every_case import every_case, every_refusal

from foretouch.cloud.geometry.sampling import SAMPLERS, UnitSphereFrame, sample_indices
from foretouch.errors import CloudError


def test_every_method_of_sampling(rng: np.random.Generator) -> None:
    xyz = rng.normal(size=(1200, 3)).astype(np.float32)

    def check(method: str) -> None:
        first, again, other = (sample_indices(xyz, 750, method=method, rng=np.random.default_rng(k)) for k in (1, 1, 2))
        assert len(np.unique(first)) == 750
        np.testing.assert_array_equal(first, again)
        assert not np.array_equal(first, other)
        for size in (1, 7, 750):  # small clouds give all their points
            index = sample_indices(xyz[:size], 750, method=method, rng=rng)
            assert len(index) == 750
            assert set(index.tolist()) == set(range(size))
        # Points in one place are never taken twice.
        assert len(np.unique(sample_indices(np.ones((50, 3), np.float32), 20, method=method, rng=rng))) == 20

    every_case(SAMPLERS, check)


def test_farthest_equals_the_plain_definition_and_voxel_is_more_even_than_random(rng: np.random.Generator) -> None:
    xyz = rng.normal(size=(300, 3)).astype(np.float32)
    index = sample_indices(xyz, 40, method="farthest", rng=rng)
    chosen = [int(index[0])]
    distances = np.linalg.norm(xyz[:, None].astype(np.float64) - xyz[None], axis=2)
    while len(chosen) < 40:
        chosen.append(int(distances[chosen].min(axis=0).argmax()))
    np.testing.assert_array_equal(index, chosen)
    dense, sparse = rng.normal(0.0, 0.01, (5000, 3)), rng.uniform(-1, 1, (500, 3))
    xyz = np.concatenate([dense, sparse])
    share = {m: (sample_indices(xyz, 300, method=m, rng=rng) >= 5000).mean() for m in ("random", "voxel")}
    assert share["random"] < 0.2
    assert share["voxel"] > 0.8


def test_what_has_no_sample_or_frame_is_refused(rng: np.random.Generator) -> None:
    cases = [
        ("N > 0", np.zeros((0, 3)), 5, "random"),
        ("n: 0", np.zeros((9, 3)), 0, "random"),
        ("'best' is not one of random, voxel, farthest", np.zeros((9, 3)), 5, "best"),
        ("not finite", np.full((9, 3), np.inf), 5, "voxel"),
    ]
    every_refusal(CloudError, cases, lambda xyz, n, method: sample_indices(xyz, n, method=method, rng=rng))
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
