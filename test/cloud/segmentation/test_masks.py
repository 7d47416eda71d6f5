# SPDX-License-Identifier: Apache-2.0
"""Objects by the labels of a mask, on the table that is found in the rest of the image."""

from pathlib import Path

import numpy as np
import pytest
from every_case import every_case

from foretouch.cloud.io.files import read_cloud
from foretouch.cloud.segmentation.masks import segment_mask
from foretouch.cloud.segmentation.segment import SegmentationConfig, segment
from foretouch.errors import CloudError
from foretouch.pipeline import Pipeline, PipelineConfig
from foretouch.types import Cloud

TABLE = Path(__file__).parents[3] / "examples" / "data" / "table.npz"
CONFIG = SegmentationConfig()


@pytest.fixture(scope="module")
def cloud() -> Cloud:
    return read_cloud(TABLE)


@pytest.fixture(scope="module")
def labels(cloud) -> np.ndarray:
    return segment(cloud, CONFIG).labels


def test_the_labels_are_the_objects_with_their_ids_and_the_table_is_that_of_the_image(cloud, labels):
    for mask in (labels, 250 * labels.astype(np.int64), np.where(labels == 0, -1, labels), labels > 0):
        found = segment_mask(cloud, mask, CONFIG)
        wanted = np.unique(np.asarray(mask)[np.asarray(mask) > 0]).tolist()
        assert found.status == "ok"
        assert sorted(int(object_.id) for object_ in found.objects) == [int(one) for one in wanted]
        truth = segment(cloud, CONFIG).table
        assert found.table.normal @ truth.normal > np.cos(np.radians(0.5))
        counts = found.counts
        parts = ("mask_no_depth", "mask_table", "mask_apart", "mask_rejected", "objects")
        assert counts["mask"] == np.count_nonzero(np.asarray(mask) > 0) == sum(counts[name] for name in parts)
        for object_ in found.objects:
            assert (found.labels.ravel()[object_.pixels] == int(object_.id)).all()
            np.testing.assert_array_equal(object_.cloud.xyz, cloud.xyz.reshape(-1, 3)[object_.pixels])


def test_what_bleeds_onto_the_table_and_behind_is_taken_out_and_counted(cloud, labels):
    mask = labels == 1
    rows, columns = np.nonzero(mask)
    wide = np.zeros_like(mask)
    wide[max(0, rows.min() - 12) : rows.max() + 13, max(0, columns.min() - 12) : columns.max() + 13] = True
    wide &= labels <= 1
    found = segment_mask(cloud, wide, CONFIG)
    (one,) = found.objects
    assert found.counts["mask_table"] > 0.2 * np.count_nonzero(wide & ~mask)
    truth = np.flatnonzero(mask)
    assert np.isin(one.pixels, truth).mean() > 0.95
    assert np.isin(truth, one.pixels).mean() > 0.97
    behind = cloud.xyz.copy()
    place = np.flatnonzero(mask)[:20]
    behind.reshape(-1, 3)[place] *= np.float32(0.7)  # nearer to the camera, by far
    assert segment_mask(Cloud(behind), mask, CONFIG).counts["mask_apart"] == 20


def test_bad_masks_are_refused_by_name(cloud, labels):
    one_pixel = np.zeros_like(labels)
    one_pixel.ravel()[np.flatnonzero(labels == 1)[0]] = 7

    def check(mask, message):
        with pytest.raises(CloudError, match=message):
            segment_mask(cloud, mask, CONFIG)

    every_case(
        [
            (labels[:-1], r"mask: shape \(\d+, \d+\) is not \(\d+, \d+\), the rows and columns of the image"),
            (np.stack([labels] * 3, axis=2), "mask: shape"),
            (np.zeros_like(labels), "mask: holds no label above 0"),
            (-labels, "mask: holds no label above 0"),
            (labels.astype(float), "mask: dtype float64 is not of whole numbers or bool"),
            (labels.astype(np.int64) * 2**31, r"mask: label \d+ is not below 2\^31"),
        ],
        check,
    )
    with pytest.raises(CloudError, match="mask: the cloud is a list of"):
        segment_mask(Cloud(cloud.xyz.reshape(-1, 3)), labels, CONFIG)
    left = segment_mask(cloud, one_pixel, CONFIG)
    assert (left.status, left.reason) == ("no_object", "mask: label 7 has 1 points above the table, fewer than 30")
    table = np.isfinite(cloud.xyz[..., 2]) & (labels == 0)
    table[: table.shape[0] // 2] = False
    off = segment_mask(cloud, table & (np.abs(segment(cloud, CONFIG).table.height(cloud.xyz)) < 0.002), CONFIG)
    assert off.status in ("no_object", "no_plane")


def test_masked_pixels_of_a_mask_are_no_object(cloud, labels):
    half = np.arange(labels.shape[1]) > np.median(np.nonzero(labels)[1])
    part = np.where(half, 0, labels)
    hidden = np.broadcast_to(half, labels.shape)
    scenes = [segment_mask(cloud, mask, CONFIG) for mask in (part, np.ma.masked_array(labels, hidden))]
    assert scenes[0].counts == scenes[1].counts
    np.testing.assert_array_equal(scenes[0].labels, scenes[1].labels)


def test_255_labels_are_255_objects_or_named(cloud, labels):
    rows, columns = np.indices(labels.shape)
    tiles = (rows // 30 * 16 + columns // 40) % 255 + 1
    found = segment_mask(cloud, tiles, CONFIG)
    assert found.status in ("ok", "no_plane", "too_few_points", "empty_cloud")
    if found.status == "ok":
        assert len(found.objects) + found.counts["n_rejected"] == 255


@pytest.mark.real_data
def test_real_images_have_as_many_objects_as_labels_and_grasps_only_on_them(real_data: Path):
    images = sorted((real_data / "real_scenes").glob("*.npz"))
    assert len(images) == 27
    pipeline = Pipeline(PipelineConfig.from_mapping({"target": {"mode": "all", "max_objects": 100}}))

    def check(path: Path) -> None:
        with np.load(path) as image:
            cloud, mask = Cloud.from_depth(image["depth_mm"], image["K"]), image["label"]
        scene = pipeline.segment(cloud, mask=mask)
        if scene.status == "doubtful_plane":  # a pile without floor
            doubtful.append(path)
            return
        assert {object_.id for object_ in scene.objects} == {str(label) for label in np.unique(mask[mask > 0])}
        for target in scene.targets:
            assert (mask.ravel()[target.pixels] == int(target.id)).all()
            for grasp in pipeline.plan(target).grasps:
                away = np.linalg.norm(target.cloud.xyz.astype(float) - grasp.midpoint, axis=1).min()
                assert away < 0.09
                assert grasp.object_id == target.id

    doubtful: list[Path] = []
    every_case([(path,) for path in images], check)
    assert len(doubtful) <= 1
