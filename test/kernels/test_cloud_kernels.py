# SPDX-License-Identifier: Apache-2.0
"""Segmentation and GeoGrasp with the compiled loops and without: the same labels, planes, counts and grasps."""

from collections.abc import Callable
from dataclasses import replace
from typing import TypeVar

import numpy as np
import numpy.typing as npt
import pytest
from corpus.clouds import MANY, object_cases, scene_cases

from foretouch import kernels
from foretouch.cloud.segmentation.clusters import ClusterConfig
from foretouch.cloud.segmentation.segment import Segmentation, SegmentationConfig, segment
from foretouch.grasp import GeoGraspConfig, GraspPlan, plan_grasps
from foretouch.selftest import table_scene
from foretouch.simulation.depth_scene import random_scene
from foretouch.types import Cloud, Float32, Plane

_SCENES = {case.name: case.cloud for case in scene_cases()}
_OBJECTS = {case.name: case for case in object_cases() if case.cloud.size < MANY // 2}
METHODS = ("original", "stable")

Result = TypeVar("Result")


def _both(function: Callable[[], Result]) -> tuple[Result, Result]:
    with kernels.disabled():
        plain = function()
    return function(), plain


def _assert_same_segmentation(a: Segmentation, b: Segmentation) -> None:
    assert (a.status, a.reason, a.counts) == (b.status, b.reason, b.counts)
    np.testing.assert_array_equal(a.labels, b.labels)
    assert (a.plane is None) == (b.plane is None)
    if a.plane is not None and b.plane is not None:
        np.testing.assert_array_equal(a.plane.coefficients, b.plane.coefficients)
    assert len(a.objects) == len(b.objects)
    for one, other in zip(a.objects, b.objects, strict=True):
        assert one.id == other.id
        for name in ("pixels", "centroid", "bounds"):
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)
            assert getattr(one, name).dtype == getattr(other, name).dtype
        np.testing.assert_array_equal(one.cloud.xyz, other.cloud.xyz)
        assert (one.cloud.rgb is None) == (other.cloud.rgb is None)
        if one.cloud.rgb is not None:
            np.testing.assert_array_equal(one.cloud.rgb, other.cloud.rgb)


@pytest.mark.parametrize("cloud", _SCENES.values(), ids=_SCENES.keys())
def test_hard_scenes_are_segmented_equally(cloud: Cloud) -> None:
    _assert_same_segmentation(*_both(lambda: segment(cloud)))


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize(("noise_m", "flying"), [(0.0, False), (0.0015, True), (0.004, True)])
def test_generated_scenes_are_segmented_equally(seed: int, noise_m: float, flying: bool) -> None:
    rng = np.random.default_rng(seed)
    size = ((848, 480), (640, 480), (333, 251), (97, 500), (320, 240), (40, 30))[seed]
    xyz = random_scene(rng, *size).render(rng, noise_m, flying).cloud().xyz
    rgb = rng.integers(0, 255, xyz.shape, np.uint8)
    _assert_same_segmentation(*_both(lambda: segment(Cloud(xyz, rgb))))


@pytest.mark.parametrize(
    "config",
    [
        ClusterConfig(gap_m=0.001, max_slope=1.0, flying_slope=1.0, min_points=1, min_top_m=0.0),
        ClusterConfig(gap_m=0.1, max_slope=100.0, flying_slope=100.0, noise_factor=0.0, min_height_m=0.001),
        ClusterConfig(max_extent_m=0.05, min_points=5000),
    ],
    ids=["all apart", "all connected", "all too large"],
)
def test_any_settings_give_equal_clusters(config: ClusterConfig, rng: np.random.Generator) -> None:
    settings = replace(SegmentationConfig(), clusters=config)
    xyz = random_scene(rng, 640, 480).render(rng, 0.001, True).cloud().xyz
    xyz[rng.random(xyz.shape[:2]) < 0.05] = np.nan
    _assert_same_segmentation(*_both(lambda: segment(Cloud(xyz), settings)))


def test_damaged_pixels_within_the_objects_are_counted_equally(rng: np.random.Generator) -> None:
    xyz = random_scene(rng, 848, 480).render(rng, 0.001, True).cloud().xyz
    flat = xyz.reshape(-1, 3)
    flat[rng.random(len(flat)) < 0.02, 0] += np.float32(0.5)
    compiled, plain = _both(lambda: segment(Cloud(xyz)))
    _assert_same_segmentation(compiled, plain)
    assert compiled.counts["off_ray"] > 100


def test_an_image_that_is_not_contiguous_is_segmented_equally() -> None:
    xyz = table_scene()
    wide = np.full((xyz.shape[0], 2 * xyz.shape[1], 3), np.nan, np.float32)
    part: Float32 = wide[:, : xyz.shape[1]]
    part[:] = xyz
    _assert_same_segmentation(segment(Cloud(part)), segment(Cloud(xyz)))


def _assert_same_plan(a: GraspPlan, b: GraspPlan, contacts_m: float, scores: float) -> None:
    assert (a.status, a.reason, a.counts) == (b.status, b.reason, b.counts)
    assert len(a.grasps) == len(b.grasps)
    for one, other in zip(a.grasps, b.grasps, strict=True):
        np.testing.assert_allclose(one.g1, other.g1, rtol=0.0, atol=contacts_m)
        np.testing.assert_allclose(one.g2, other.g2, rtol=0.0, atol=contacts_m)
        np.testing.assert_allclose(one.rotation, other.rotation, rtol=0.0, atol=1e-8)
        np.testing.assert_allclose(one.score, other.score, rtol=0.0, atol=scores)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", _OBJECTS)
def test_hard_objects_have_equal_plans(name: str, method: str) -> None:
    case = _OBJECTS[name]
    config = GeoGraspConfig(count=4, method=method)
    compiled, plain = _both(lambda: plan_grasps(case.cloud, case.plane, config))
    exact = 0.0 if method == "original" else 1e-9
    _assert_same_plan(compiled, plain, exact, 1e-7)


@pytest.mark.parametrize("method", METHODS)
def test_objects_of_a_scene_have_equal_plans(method: str, rng: np.random.Generator) -> None:
    """The contacts of `original` are means that both forms sum in one order; of `stable` within 1e-12 m."""
    found = segment(random_scene(rng, 848, 480).render(rng, 0.001, True).cloud())
    assert found.plane is not None
    for one in found.objects:
        config = GeoGraspConfig(count=4, method=method)
        plan = _planner(one.cloud, found.plane, config, one.pixels)
        _assert_same_plan(*_both(plan), 0.0 if method == "original" else 1e-12, 1e-9)


def _planner(
    cloud: Cloud, plane: Plane, config: GeoGraspConfig, pixels: npt.NDArray[np.int64]
) -> Callable[[], GraspPlan]:
    return lambda: plan_grasps(cloud, plane, config, pixels=pixels, image_shape=(480, 848))


def test_the_order_of_the_points_leaves_the_neighbours_alone(rng: np.random.Generator) -> None:
    """Of one cloud, known pixels or not, sorted or not, the compiled search finds the same."""
    cloud = _OBJECTS["bar"].cloud
    order = rng.permutation(cloud.size)
    config = GeoGraspConfig(method="stable")
    plane = _OBJECTS["bar"].plane
    first, second = plan_grasps(cloud, plane, config), plan_grasps(Cloud(cloud.xyz[order]), plane, config)
    np.testing.assert_array_equal(first.grasps[0].g1, second.grasps[0].g1)
