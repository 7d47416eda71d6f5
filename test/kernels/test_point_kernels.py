# SPDX-License-Identifier: Apache-2.0
"""Neighbours, moments, voxels and orders of points against the references; plans as a whole are those of `test_parity.py`."""

from collections.abc import Iterator

import numpy as np
from corpus.clouds import object_cases
from every_case import every_case
from kernels.references import points as reference
from scene_builders import table_scene

from foretouch.cloud.geometry import flying, pcl_filters
from foretouch.cloud.geometry.pcl_filters import (
    cell_means,
    count_without_normal,
    mean_neighbour_distance,
    normals_and_curvature,
    voxel_grid,
)
from foretouch.errors import CloudError
from foretouch.grasp import preprocessing
from foretouch.types import Float32

_MOST = 6000  # points of a case; the references take seconds of more


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
    yield "part of an image, shuffled, with far points", rng.permutation(far)
    lattice = np.stack(np.meshgrid(*[np.arange(12.0)] * 3), axis=-1)
    yield "a lattice with ties", lattice.reshape(-1, 3).astype(np.float32)
    yield "a line in doubling steps", np.outer(2.0 ** np.arange(-60, 10), np.ones(3)).astype(np.float32)
    yield "a pile beside a plane", np.concatenate([np.tile(image[:1], (300, 1)), image])
    yield "around zero", rng.normal(0.0, 1e-20, (300, 3)).astype(np.float32)
    for n in (2, 7, 8, 9, 63, 64, 65, 511, 513, 4097):
        yield f"{n} points", (rng.normal(0.0, 0.05, (n, 3)) * [1.0, 1.0, 0.01]).astype(np.float32)


HARD = dict(_hard_clouds())


def test_neighbour_distances(rng: np.random.Generator) -> None:
    def check(xyz: Float32) -> None:
        some = np.arange(0, len(xyz), max(1, len(xyz) // 200))
        for k in (1, 8, 50):
            found = mean_neighbour_distance(xyz, k)[some]
            np.testing.assert_array_equal(found, reference.mean_neighbour_distance(xyz, k, some), f"k {k}")

    pile = np.concatenate([np.zeros((5000, 3)), rng.normal(1.0, 0.01, (200, 3))]).astype(np.float32)
    every_case(HARD | {"pile": pile}, check)
    mean, proven = np.empty(len(pile), np.float32), np.empty(len(pile), np.uint8)
    pcl_filters._mean_neighbour_distance(pile, len(pile), 50, mean, proven)
    assert not proven[:5000].any()  # more than it gathers around one place: left to the tree
    assert proven[5000:].all()


def test_normals() -> None:
    """Within rounding, and up to the direction where the two smaller eigenvalues are the same."""

    def check(xyz: Float32) -> None:
        some = np.arange(0, len(xyz), max(1, len(xyz) // 200))
        normal, curvature = normals_and_curvature(xyz, some)
        plain, other = reference.normals_and_curvature(xyz, some)
        np.testing.assert_array_equal(np.isnan(curvature), np.isnan(other))
        np.testing.assert_allclose(curvature, other, atol=1e-9)
        unlike = np.abs(np.abs(np.einsum("ij,ij->i", normal, plain)) - 1.0) > 1e-6
        assert np.count_nonzero(unlike) <= 0.02 * len(some)
        if len(xyz) < _MOST // 3:
            assert count_without_normal(xyz) == reference.count_without_normal(xyz)

    every_case(HARD, check)


def test_flying_points(rng: np.random.Generator) -> None:
    found = [0, 0]

    def check(xyz: Float32) -> None:
        before = xyz + np.array([0.0, 0.0, 1.0], np.float32)  # the camera
        before[rng.random(len(xyz)) < 0.05] *= np.float32(0.97)
        for points in (xyz, before):
            n, marked, radius = len(points), np.empty(len(points), np.uint8), np.empty(1)
            once, twice = (np.array([20.0, 1.0, 0.008, 2.0, 0.5, 1.0, 0.75, support]) for support in (-2.0, 3.0))
            flying._flying(points, n, once, marked, radius)
            if radius[0] == 0.0:
                assert not marked.any()
            else:
                some = rng.permutation(n)[:100]
                expected = reference.flying_points(points, some, radius[0], *once[2:6])
                np.testing.assert_array_equal(marked[some], expected)
                rest = np.flatnonzero(marked == 0)
                flying._flying(points, n, twice, marked, radius)
                some = rng.permutation(len(rest))[:100]
                again = reference.flying_points(points[rest], some, radius[0], *twice[2:4], *twice[6:])
                np.testing.assert_array_equal(marked[rest[some]], again & (len(rest) < n))
                few = marked.copy()
                flying._flying(points, n, np.array([20.0, n + 1.0, *twice[2:]]), few, radius)
                assert not few.any()
            found[0] += radius[0] > 0.0
            found[1] += int(marked.sum())

    every_case({name: xyz for name, xyz in HARD.items() if np.abs(xyz).max() < 1e6}, check)
    assert found[0] > 20
    assert found[1] > 500


def test_voxels_and_canonical_order(rng: np.random.Generator) -> None:
    def check(xyz: Float32) -> None:
        try:
            found = voxel_grid(xyz, 0.0125)
        except CloudError as err:
            assert "too many to number" in str(err)  # noqa: PT017
        else:
            cell, counts = reference.voxels(xyz, 0.0125)
            np.testing.assert_array_equal(found[0], cell)
            np.testing.assert_array_equal(found[1], counts)
            values = np.column_stack([xyz.astype(np.float64), np.where(xyz[:, 0] > 0.0, np.nan, 1.0)])
            np.testing.assert_array_equal(cell_means(values, found), reference.cell_means(values, cell, counts))
        coarse = np.round(rng.permutation(xyz), 2).astype(np.float32)  # with many ties
        for points in (xyz, coarse, -coarse):
            np.testing.assert_array_equal(preprocessing._canonical_order(points), reference.canonical_order(points))

    every_case(HARD, check)
