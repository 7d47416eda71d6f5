# SPDX-License-Identifier: Apache-2.0
"""Fixed-size sampling and the unit sphere."""

from __future__ import annotations

import numpy as np
import pytest

from foretouch.cloud.geometry.sampling import SAMPLERS, UnitSphereFrame, sample_indices
from foretouch.errors import CloudError
from foretouch.types import Grasp


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
def test_invalid_sampling_is_refused(
    xyz: np.ndarray, n: int, method: str, message: str, rng: np.random.Generator
) -> None:
    with pytest.raises(CloudError, match=message):
        sample_indices(xyz, n, method=method, rng=rng)


def test_hand_worked_frame() -> None:
    frame = UnitSphereFrame.fit(np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 3.0]], np.float32))
    np.testing.assert_allclose(frame.centre, [0, 0, 2])
    assert frame.scale == pytest.approx(1.0)


def test_points_fill_the_unit_sphere_and_return(rng: np.random.Generator) -> None:
    xyz = rng.normal([0.1, -0.2, 1.2], 0.05, (500, 3)).astype(np.float32)
    frame = UnitSphereFrame.fit(xyz)
    moved = frame.apply_points(xyz)
    np.testing.assert_allclose(moved.mean(axis=0), 0.0, atol=1e-12)
    assert np.linalg.norm(moved, axis=1).max() == pytest.approx(1.0)
    np.testing.assert_allclose(frame.invert_points(moved), xyz, atol=1e-12)


def test_grasp_moves_with_its_cloud(rng: np.random.Generator) -> None:
    xyz = rng.normal(1.0, 0.05, (100, 3)).astype(np.float32)
    rotation = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    grasp = Grasp(xyz[3].astype(np.float64), xyz[70].astype(np.float64), rotation, 1.5, "a", "b")
    frame = UnitSphereFrame.fit(xyz)
    moved = frame.apply_grasp(grasp)
    np.testing.assert_allclose(moved.g1, frame.apply_points(xyz)[3])
    np.testing.assert_allclose(moved.width_m * frame.scale, grasp.width_m)
    np.testing.assert_array_equal(moved.rotation, rotation)
    back = frame.invert_grasp(moved)
    np.testing.assert_allclose([back.g1, back.g2], [grasp.g1, grasp.g2], atol=1e-12)
    assert (back.score, back.id, back.object_id) == (1.5, "a", "b")


def test_a_shift_and_a_scale_change_nothing(rng: np.random.Generator) -> None:
    xyz = rng.normal(0.0, 0.05, (200, 3))
    other = 3.0 * xyz + [0.4, 0.0, 1.0]
    np.testing.assert_allclose(
        UnitSphereFrame.fit(xyz).apply_points(xyz), UnitSphereFrame.fit(other).apply_points(other), atol=1e-12
    )


@pytest.mark.parametrize(
    ("xyz", "message"),
    [
        (np.zeros((0, 3)), "N > 0"),
        (np.ones((5, 3)), "5 points coincide at"),
        (np.array([[0.0, 0, 1], [np.nan, 0, 1]]), "not finite"),
        (np.zeros((5, 2)), r"\(5, 2\)"),
    ],
)
def test_invalid_clouds_have_no_frame(xyz: np.ndarray, message: str) -> None:
    with pytest.raises(CloudError, match=message):
        UnitSphereFrame.fit(xyz)
