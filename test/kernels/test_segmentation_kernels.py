# SPDX-License-Identifier: Apache-2.0
"""Segmentation with the compiled loops and with their references: the same labels, planes and counts, bit by bit."""

from dataclasses import replace
from operator import attrgetter

import numpy as np
import pytest
from corpus.clouds import scene_cases
from every_case import every_case
from kernels.references import segmentation as reference

from benchmarks.random_scenes import random_scene
from foretouch.cloud.segmentation import objects, plane
from foretouch.cloud.segmentation import segment as segment_module
from foretouch.cloud.segmentation.clusters import ClusterConfig
from foretouch.cloud.segmentation.segment import SegmentationConfig, segment
from foretouch.pipeline import Pipeline
from foretouch.types import AnyArray, CameraModel, Cloud
from foretouch.types.scene import Scene


def _with_references(cloud: Cloud, config: SegmentationConfig) -> Scene:
    with pytest.MonkeyPatch.context() as patch:
        for module, names in (
            (segment_module, {"_count_depths": "count_range", "_every": "every", "label_organised": "label_organised"}),
            (plane, {"_counts": "counts", "_near": "near", "_residuals": "residuals"}),
            (objects, {"_candidates": "candidates", "_write_ids": "write_ids"}),
        ):
            for name, other in names.items():
                patch.setattr(module, name, getattr(reference, other))
        return segment(cloud, config)


def _assert_same(cloud: Cloud, config: SegmentationConfig | None = None) -> Scene:
    config = config or SegmentationConfig()
    ours, plain = segment(cloud, config), _with_references(cloud, config)
    assert (ours.status, ours.reason, ours.counts) == (plain.status, plain.reason, plain.counts)
    np.testing.assert_array_equal(ours.labels, plain.labels)
    assert (ours.table is None) == (plain.table is None)
    if ours.table is not None and plain.table is not None:
        np.testing.assert_array_equal(ours.table.coefficients, plain.table.coefficients)
    parts = attrgetter("id", "pixels", "centroid", "bounds", "cloud.xyz", "cloud.rgb")
    for object_, other in zip(ours.objects, plain.objects, strict=True):
        for first, second in zip(parts(object_), parts(other), strict=True):
            np.testing.assert_array_equal(first, second)
    return ours


def test_hard_and_generated_scenes_and_any_settings(rng: np.random.Generator) -> None:
    sizes = ((848, 480), (640, 480), (333, 251), (97, 500), (320, 240), (40, 30))
    images = ((0.0, False), (0.0015, True), (0.004, True))

    def check(seed: int, size: tuple[int, int], noise_m: float, flying: bool) -> None:
        rng = np.random.default_rng(seed)
        xyz = random_scene(rng, *size).render(rng, noise_m, flying).cloud().xyz
        _assert_same(Cloud(xyz, rng.integers(0, 255, xyz.shape, np.uint8)))
        _assert_same(Cloud(xyz[::3, ::3].reshape(-1, 3)))

    every_case({f"{size} {image}": (k, size, *image) for k, size in enumerate(sizes) for image in images}, check)
    every_case({case.name: case.cloud for case in scene_cases()}, _assert_same)
    xyz = random_scene(rng, 640, 480).render(rng, 0.001, True).cloud().xyz
    xyz[rng.random(xyz.shape[:2]) < 0.05] = np.nan
    settings = {
        "all apart": ClusterConfig(gap_m=0.001, min_points=1, min_top_m=0.0),
        "connected": ClusterConfig(gap_m=0.1, min_height_m=0.001),
        "all too large": ClusterConfig(max_extent_m=0.05, min_points=5000),
    }
    every_case(settings, lambda one: _assert_same(Cloud(xyz), replace(SegmentationConfig(), clusters=one)))


def test_damaged_pixels_and_an_image_that_is_not_contiguous(rng: np.random.Generator) -> None:
    xyz = random_scene(rng, 848, 480).render(rng, 0.001, True).cloud().xyz
    flat = xyz.reshape(-1, 3)
    flat[rng.random(len(flat)) < 0.02, 0] += np.float32(0.5)
    wide = np.full((480, 2 * 848, 3), np.nan, np.float32)
    wide[:, :848] = xyz
    ours, part = _assert_same(Cloud(xyz)), _assert_same(Cloud(wide[:, :848]))
    assert ours.counts["off_ray"] > 100
    assert part.counts == ours.counts
    np.testing.assert_array_equal(part.labels, ours.labels)


def test_a_depth_image_gives_what_its_points_give_without_making_all_of_them(rng: np.random.Generator) -> None:
    rendered = random_scene(rng, 848, 480).render(rng, 0.001, True)
    camera = rendered.cloud().camera
    assert camera is not None
    bent = replace(camera, distortion=(0.1, -0.2, 0.001, -0.001))
    metres = np.where(rendered.depth_mm > 0, rendered.depth_mm * np.float32(0.001), np.float32(np.nan))
    metres[rng.random(metres.shape) < 0.01] = np.inf
    small, fewest = (slice(0, 480, 8), slice(0, 848, 8)), np.where(rng.random(metres.shape) < 0.01, metres, 0.0)
    thin = CameraModel(106, 60, camera.fx / 8, camera.fy / 8, camera.cx / 8, camera.cy / 8)
    piled = np.random.default_rng(26)
    touching = random_scene(piled, 848, 480, n_objects=int(piled.integers(2, 9))).render(piled, 0.001, True)
    assert segment(touching.cloud()).counts["parts"] > 0  # between their windows, too, points are read
    cases = {
        "touching": (touching.depth_mm, touching.cloud().camera),
        "whole": (rendered.depth_mm, camera),
        "distorted": (rendered.depth_mm, bent),
        "single": (metres, camera),
        "single, distorted": (metres.astype(np.float64), bent),
        "all pixels": (np.ascontiguousarray(metres[small]), thin),
        "few pixels": (fewest, camera),
        "no pixel": (np.zeros_like(rendered.depth_mm), camera),
    }

    def check(depth: AnyArray, model: CameraModel) -> None:
        cloud = Cloud.from_depth(depth, model)
        ours = _assert_same(cloud)
        Pipeline().segment(cloud)
        assert ("xyz" in vars(cloud)) == (ours.status == "empty_cloud")  # for the reason, and nowhere else
        plain = segment(Cloud(model.points(depth), camera=model))
        assert (ours.status, ours.reason, ours.counts) == (plain.status, plain.reason, plain.counts)
        np.testing.assert_array_equal(ours.labels, plain.labels)
        for object_, other in zip(ours.objects, plain.objects, strict=True):
            np.testing.assert_array_equal(object_.cloud.xyz, other.cloud.xyz)
        assert replace(cloud, frame_id="other").size == cloud.size == depth.size

    every_case(cases, check)
