# SPDX-License-Identifier: Apache-2.0
"""Objects on tables: against the truth of rendered scenes, and the reported reason if there are none."""

from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from every_case import every_case

from benchmarks.random_scenes import random_scene
from foretouch.cloud.io.files import read_cloud
from foretouch.cloud.segmentation.clusters import ClusterConfig
from foretouch.cloud.segmentation.segment import SegmentationConfig, segment
from foretouch.types import Cloud
from foretouch.types.scene import Scene
from foretouch_lab.simulation.depth_scene import RenderedFrame


def _overlaps(segmentation: Scene, truth: npt.NDArray[np.int_], first: int = 2) -> list[float]:
    """For each true object the intersection over union with the one that covers it most."""
    result = []
    for label in range(first, int(truth.max()) + 1):
        true = truth == label
        best = 1 + int(np.bincount(segmentation.labels[true], minlength=2)[1:].argmax())
        found = segmentation.labels == best
        result.append(float((true & found).sum() / (true | found).sum()))
    return result


def _image(seed: int, *, noise_m: float = 0.001, flying_pixels: bool = False, **changes) -> RenderedFrame:
    rng = np.random.default_rng(seed)
    return random_scene(rng, **changes).render(rng, noise_m, flying_pixels)


def _checked(cloud: Cloud, config: SegmentationConfig | None = None) -> Scene:
    """A segmentation, with the invariants of every result."""
    segmentation = segment(cloud, config)
    counts = segmentation.counts
    parts = ("not_finite", "out_of_range", "off_ray", "background", "rejected", "flying", "objects")
    assert counts["received"] == cloud.size == sum(counts[name] for name in parts)
    assert min(counts.values()) >= 0
    assert segmentation.labels.shape == cloud.xyz.shape[:-1]
    assert segmentation.labels.dtype == np.int32
    assert (segmentation.reason == "") == (segmentation.status == "ok") == bool(segmentation.objects)
    assert {"total"} <= set(segmentation.ms)
    assert counts["objects"] == sum(obj.n_points for obj in segmentation.objects)
    flat, labels = cloud.xyz.reshape(-1, 3), segmentation.labels.reshape(-1)
    for number, obj in enumerate(segmentation.objects, 1):
        assert obj.id == str(number)
        np.testing.assert_array_equal(obj.cloud.xyz, flat[obj.pixels])
        assert np.isfinite(obj.cloud.xyz).all()
        assert (labels[obj.pixels] == number).all()
        assert (np.diff(obj.pixels) > 0).all()
        np.testing.assert_allclose(obj.centroid, obj.cloud.xyz.mean(axis=0, dtype=np.float64))
        np.testing.assert_array_equal(obj.bounds, [obj.cloud.xyz.min(axis=0), obj.cloud.xyz.max(axis=0)])
    distances = [obj.distance_m for obj in segmentation.objects]
    assert distances == sorted(distances)
    return segmentation


def test_all_objects_and_no_others_are_found() -> None:
    effects = [(0.0, False, 0.95), (0.001, False, 0.95), (0.002, False, 0.95), (0.001, True, 0.92)]

    def check(seed: int, noise_m: float, flying: bool, least: float) -> None:
        image = _image(seed, noise_m=noise_m, flying_pixels=flying)
        segmentation = _checked(image.cloud())
        assert len(segmentation.objects) == 3
        assert min(_overlaps(segmentation, image.labels)) >= least
        np.testing.assert_allclose(segmentation.table.coefficients, image.plane, atol=2e-3)

    every_case([(seed, *effects[seed % 4]) for seed in range(24)], check)


def test_objects_before_others_and_clouds_without_order() -> None:
    def check(seed: int) -> None:
        image = _image(seed, flying_pixels=True, may_occlude=True)
        segmentation = segment(image.cloud())
        assert len(segmentation.objects) == 3
        assert min(_overlaps(segmentation, image.labels)) >= 0.9
        image = _image(seed)
        keep = image.depth_mm.reshape(-1) > 0
        segmentation = _checked(Cloud(image.cloud().xyz.reshape(-1, 3)[keep]))
        assert len(segmentation.objects) == 3
        assert min(_overlaps(segmentation, image.labels.reshape(-1)[keep])) >= 0.9

    every_case(range(0, 50, 10), check)


def test_resolutions_colours_frame_and_stamp_do_not_matter_or_are_kept(rng: np.random.Generator) -> None:
    def check(width: int, height: int) -> None:
        image = _image(1, width=width, height=height)
        segmentation = segment(image.cloud())
        assert len(segmentation.objects) == 3
        assert min(_overlaps(segmentation, image.labels)) >= 0.93

    every_case([(1280, 720), (640, 480), (424, 240)], check)
    image = _image(2, flying_pixels=True)
    coarse, shipped = (segment(image.cloud(), SegmentationConfig(grid_rows=rows)) for rows in (60, 120))
    assert len(coarse.objects) == len(shipped.objects) == 3
    assert 0.9 < np.mean(_overlaps(coarse, image.labels)) < np.mean(_overlaps(shipped, image.labels))
    xyz = _image(4).cloud().xyz
    rgb = rng.integers(0, 256, xyz.shape, dtype=np.uint8)
    coloured = segment(Cloud(xyz, rgb, "camera", 42))
    for obj in coloured.objects:
        np.testing.assert_array_equal(obj.cloud.rgb, rgb.reshape(-1, 3)[obj.pixels])
        assert (obj.cloud.frame_id, obj.cloud.stamp_ns) == ("camera", 42)


def _table(rng: np.random.Generator, n: int = 20_000) -> npt.NDArray[np.float32]:
    points = rng.uniform((-0.4, -0.3, 0.0), (0.4, 0.3, 0.0), (n, 3)) + np.array([0.0, 0.0, 1.0])
    return (points + rng.normal(0.0, 0.0005, points.shape)).astype(np.float32)


def test_without_a_plausible_object_the_reason_is_named(rng: np.random.Generator) -> None:
    bare = segment(Cloud(_table(rng)))
    assert bare.status == "no_object"
    assert "nothing stands more than 4 mm above the table" in bare.reason
    np.testing.assert_allclose(bare.table.coefficients, [0, 0, -1, 1], atol=1e-3)  # towards the camera
    assert segment(random_scene(rng, n_objects=0).render(rng, 0.002).cloud()).status == "no_object"
    crumb = rng.uniform((0.0, 0.0, 0.97), (0.02, 0.02, 0.98), (100, 3)).astype(np.float32)
    wall = rng.uniform((-0.4, 0.29, 0.6), (0.4, 0.3, 0.98), (4000, 3)).astype(np.float32)
    whole = SegmentationConfig().updated(
        {"split.angle_deg": 180.0}
    )  # points at random in a wall are no surface, and would be split
    rejected = segment(Cloud(np.concatenate([_table(rng), crumb, wall])), whole)
    assert rejected.status == "no_object"
    assert rejected.counts["n_rejected"] >= 2
    assert "none with 150 points" in rejected.reason
    slab = rng.uniform((0.0, 0.0, 0.98), (0.1, 0.1, 0.98), (3000, 3)).astype(np.float32)  # 2 cm high
    cloud = Cloud(np.concatenate([_table(rng), slab]))
    assert len(segment(cloud).objects) == 1
    high = SegmentationConfig(clusters=ClusterConfig(min_height_m=0.03))
    assert segment(cloud, high).status == "no_object"


@pytest.mark.real_data
def test_shared_scenes_and_real_object_clouds(real_data: Path) -> None:
    for name in ("oblique_848x480", "oblique_1280x720"):
        with np.load(real_data / "scenes" / f"{name}.npz") as scene:
            xyz, truth, plane = scene["xyz"], scene["labels"].astype(np.int32), scene["plane"]
        segmentation = segment(Cloud(xyz))
        assert len(segmentation.objects) == 3
        assert min(_overlaps(segmentation, truth)) >= 0.98
        np.testing.assert_allclose(segmentation.table.coefficients, plane, atol=5e-4)
    for path in sorted(real_data.glob("vision2tactile/*/*/cloud-object.pcd"))[::10]:
        _checked(read_cloud(path))


def _assert_equal(image: Scene, other: Scene) -> None:
    assert (image.status, image.counts) == (other.status, other.counts)
    np.testing.assert_array_equal(image.labels, other.labels)
    if image.table is not None and other.table is not None:
        np.testing.assert_array_equal(image.table.coefficients, other.table.coefficients)
    for mine, theirs in zip(image.objects, other.objects, strict=True):
        np.testing.assert_array_equal(mine.cloud.xyz, theirs.cloud.xyz)
        np.testing.assert_array_equal(mine.pixels, theirs.pixels)


def test_a_known_camera_gives_what_is_recovered_without_one() -> None:
    for seed in range(3):
        cloud = _image(seed, flying_pixels=True).cloud()
        assert cloud.camera is not None
        _assert_equal(_checked(cloud), _checked(Cloud(cloud.xyz)))


@pytest.mark.real_data
def test_depth_images_of_others_give_what_their_clouds_give(real_data: Path) -> None:
    for file in sorted((real_data / "real_scenes").glob("*.npz")):
        with np.load(file) as scene:
            cloud = Cloud.from_depth(scene["depth_mm"], scene["K"])
        _assert_equal(_checked(cloud), _checked(Cloud(cloud.xyz)))
