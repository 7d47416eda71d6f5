# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest

from foretouch.cloud.geometry.sampling import SAMPLERS, sample_indices
from foretouch.errors import CloudError


@pytest.mark.parametrize("method", SAMPLERS)
def test_all_different_and_the_seed_decides(method: str, rng: np.random.Generator) -> None:
    xyz = rng.normal(size=(1200, 3)).astype(np.float32)
    first, again, other = (
        sample_indices(xyz, 750, method=method, rng=np.random.default_rng(seed)) for seed in (1, 1, 2)
    )
    assert len(np.unique(first)) == 750
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)


@pytest.mark.parametrize("method", SAMPLERS)
@pytest.mark.parametrize("size", [1, 7, 750])
def test_small_clouds_give_all_their_points(method: str, size: int, rng: np.random.Generator) -> None:
    index = sample_indices(rng.normal(size=(size, 3)), 750, method=method, rng=rng)
    assert len(index) == 750
    assert set(index.tolist()) == set(range(size))


@pytest.mark.parametrize("method", SAMPLERS)
def test_points_in_one_place_are_never_taken_twice(method: str, rng: np.random.Generator) -> None:
    index = sample_indices(np.ones((50, 3), np.float32), 20, method=method, rng=rng)
    assert len(np.unique(index)) == 20


def test_farthest_equals_the_plain_definition(rng: np.random.Generator) -> None:
    xyz = rng.normal(size=(300, 3)).astype(np.float32)
    index = sample_indices(xyz, 40, method="farthest", rng=rng)
    chosen = [int(index[0])]
    distances = np.linalg.norm(xyz[:, None].astype(np.float64) - xyz[None], axis=2)
    while len(chosen) < 40:
        chosen.append(int(distances[chosen].min(axis=0).argmax()))
    np.testing.assert_array_equal(index, chosen)


def test_voxel_is_more_even_than_random(rng: np.random.Generator) -> None:
    dense, sparse = rng.normal(0.0, 0.01, (5000, 3)), rng.uniform(-1, 1, (500, 3))
    xyz = np.concatenate([dense, sparse])
    share = {m: (sample_indices(xyz, 300, method=m, rng=rng) >= 5000).mean() for m in ("random", "voxel")}
    assert share["random"] < 0.2
    assert share["voxel"] > 0.8


@pytest.mark.parametrize(
    ("xyz", "n", "method", "message"),
    [
        (np.zeros((0, 3)), 5, "random", "N > 0"),
        (np.zeros((9, 3)), 0, "random", "n: 0"),
        (np.zeros((9, 3)), 5, "best", "'best' is none of random, voxel, farthest"),
        (np.full((9, 3), np.inf), 5, "voxel", "not finite"),
    ],
)
def test_refusals(xyz: np.ndarray, n: int, method: str, message: str, rng: np.random.Generator) -> None:
    with pytest.raises(CloudError, match=message):
        sample_indices(xyz, n, method=method, rng=rng)
