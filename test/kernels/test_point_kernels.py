# SPDX-License-Identifier: Apache-2.0
"""Neighbours, moments, voxels and orders of points: the compiled loops against NumPy and small_gicp."""

from collections.abc import Callable, Iterator
from typing import TypeVar

import numpy as np
import numpy.typing as npt
import pytest
from corpus.clouds import object_cases

from foretouch import kernels
from foretouch.cloud.geometry import pcl_filters
from foretouch.cloud.geometry.pcl_filters import (
    count_without_normal,
    inlier_mask,
    mean_neighbour_distance,
    normals_and_curvature,
    voxel_grid,
)
from foretouch.errors import CloudError
from foretouch.grasp.preprocessing import _canonical_order
from foretouch.kernels import Kernel
from foretouch.selftest import table_scene
from foretouch.types import Float32

_MOST = 6000  # points of a case; the NumPy forms take seconds of more

Result = TypeVar("Result")


def _numpy(function: Callable[[], Result]) -> Result:
    with kernels.disabled():
        return function()


def _hard_clouds() -> Iterator[tuple[str, Float32]]:
    """The finite points of the hard cases, and some more that searches find hard."""
    for case in object_cases():
        xyz = case.cloud.xyz.reshape(-1, 3).astype(np.float32)
        xyz = np.ascontiguousarray(xyz[np.isfinite(xyz).all(axis=1)])
        if 2 <= len(xyz) <= _MOST and np.abs(xyz).max() < 1e9:  # plan_grasps refuses others, whose squares overflow
            yield case.name, xyz
    rng = np.random.default_rng(0)
    image = table_scene()[80:160, 120:200].reshape(-1, 3)
    image = image[np.isfinite(image).all(axis=1)]
    far = np.concatenate([image, rng.normal(0.0, 300.0, (40, 3)).astype(np.float32)])
    yield "part of an image", image
    yield "part of an image, shuffled, with far points", rng.permutation(far)
    yield (
        "a lattice with ties",
        np.stack(np.meshgrid(*[np.arange(12.0)] * 3), axis=-1).reshape(-1, 3).astype(np.float32),
    )
    yield "a line in doubling steps", np.outer(2.0 ** np.arange(-60, 10), np.ones(3)).astype(np.float32)
    yield "a pile beside a plane", np.concatenate([np.tile(image[:1], (300, 1)), image])
    yield "around zero", rng.normal(0.0, 1e-20, (300, 3)).astype(np.float32)


_HARD = dict(_hard_clouds())
_each = pytest.mark.parametrize("xyz", _HARD.values(), ids=_HARD.keys())


@_each
@pytest.mark.parametrize("k", [1, 8, 50])
def test_neighbour_distances_are_those_of_the_tree(xyz: Float32, k: int) -> None:
    compiled = mean_neighbour_distance(xyz, k)
    tree = _numpy(lambda: mean_neighbour_distance(xyz, k))
    # Of neighbours that are equally far in float32, the tree takes those that are nearer in float64.
    np.testing.assert_allclose(compiled, tree, rtol=3e-7, atol=0.0)


@_each
def test_inliers_are_those_of_the_tree(xyz: Float32) -> None:
    np.testing.assert_array_equal(inlier_mask(xyz), _numpy(lambda: inlier_mask(xyz)))


def test_a_pile_of_points_is_left_to_the_tree(rng: np.random.Generator) -> None:
    xyz = np.concatenate([np.zeros((5000, 3)), rng.normal(1.0, 0.01, (200, 3))]).astype(np.float32)
    mean, proven = np.empty(len(xyz), np.float32), np.empty(len(xyz), np.uint8)
    pcl_filters._mean_neighbour_distance(xyz, len(xyz), 50, mean, proven)
    assert not proven[:5000].any()  # more than it gathers around one place
    assert proven[5000:].all()
    np.testing.assert_array_equal(mean_neighbour_distance(xyz, 50), _numpy(lambda: mean_neighbour_distance(xyz, 50)))


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 3e38, -0.0, 1e-42])
def test_any_numbers_are_read_without_a_fault(value: float, rng: np.random.Generator) -> None:
    """Callers pass finite points; whatever else is passed must not reach beyond an array, or take forever."""
    xyz = rng.normal(0.0, 1.0, (777, 3)).astype(np.float32)
    xyz[rng.random(xyz.shape) < 0.3] = value
    xyz[:50] = value
    mean, proven = np.empty(len(xyz), np.float32), np.empty(len(xyz), np.uint8)
    pcl_filters._mean_neighbour_distance(xyz, len(xyz), 50, mean, proven)
    sums, normals, curvature = np.empty((777, 10)), np.empty((777, 3)), np.empty(777)
    pcl_filters._compiled_moments(xyz, len(xyz), xyz, len(xyz), 0.1, xyz[0], sums)
    pcl_filters._fit_planes(sums, xyz, len(xyz), 1e-8, normals, curvature)
    cell, counts, found = np.empty(777, np.int64), np.empty(777, np.int64), np.empty(1, np.int64)
    pcl_filters._voxel_cells(xyz, len(xyz), 80.0, cell, counts, found)
    assert found[0] == -1 or counts[: found[0]].sum() == len(xyz)


@pytest.mark.parametrize("n", [1, 2, 7, 8, 9, 63, 64, 65, 511, 513, 4097])
def test_every_size_of_the_tree(n: int, rng: np.random.Generator) -> None:
    xyz = (rng.normal(0.0, 0.05, (n, 3)) * [1.0, 1.0, 0.01]).astype(np.float32)
    np.testing.assert_array_equal(mean_neighbour_distance(xyz, 50), _numpy(lambda: mean_neighbour_distance(xyz, 50)))
    some = np.arange(0, n, 3)
    for compiled, plain in zip(
        normals_and_curvature(xyz, some), _numpy(lambda: normals_and_curvature(xyz, some)), strict=True
    ):
        np.testing.assert_allclose(compiled, plain, atol=1e-9)


@_each
def test_voxels_are_equal(xyz: Float32) -> None:
    try:
        plain = _numpy(lambda: voxel_grid(xyz, 0.0125))
    except CloudError:
        with pytest.raises(CloudError, match="too many to number"):
            voxel_grid(xyz, 0.0125)
        return
    compiled = voxel_grid(xyz, 0.0125)
    np.testing.assert_array_equal(compiled.cell, plain.cell)
    np.testing.assert_array_equal(compiled.counts, plain.counts)
    values = np.column_stack([xyz.astype(np.float64), np.where(xyz[:, 0] > 0.0, np.nan, 1.0)])
    np.testing.assert_array_equal(compiled.mean(values), _numpy(lambda: plain.mean(values)))


@_each
def test_normals_are_equal(xyz: Float32) -> None:
    """Within rounding, and up to the direction where the two smaller eigenvalues are the same."""
    some = np.arange(0, len(xyz), max(1, len(xyz) // 200))
    (normal, curvature), (plain, other) = (
        normals_and_curvature(xyz, some),
        _numpy(lambda: normals_and_curvature(xyz, some)),
    )
    np.testing.assert_array_equal(np.isnan(curvature), np.isnan(other))
    np.testing.assert_allclose(curvature, other, atol=1e-9)
    unlike = np.abs(np.abs(np.einsum("ij,ij->i", normal, plain)) - 1.0) > 1e-6
    assert np.count_nonzero(unlike) <= 0.02 * len(some)
    assert count_without_normal(xyz) == _numpy(lambda: count_without_normal(xyz))


@_each
def test_canonical_order_is_equal(xyz: Float32, rng: np.random.Generator) -> None:
    coarse = np.round(rng.permutation(xyz), 2).astype(np.float32)  # with many ties
    for points in (xyz, coarse, -coarse):
        np.testing.assert_array_equal(_canonical_order(points), _numpy(lambda points=points: _canonical_order(points)))


def test_a_wrong_name_or_count_is_refused() -> None:
    with pytest.raises(AttributeError):
        Kernel("no_such_function", int)
    wrong: npt.NDArray[np.float64] = np.zeros(3)
    with pytest.raises(TypeError, match="summed_moments: an array of float64"):
        pcl_filters._compiled_moments(wrong, 1, wrong, 1, 0.1, wrong, wrong)
