# SPDX-License-Identifier: Apache-2.0
"""What is kept, by hand."""

from __future__ import annotations

import numpy as np
import pytest

from foretouch.cloud.segmentation.crop import CropConfig, crop_box, crop_range, in_range
from foretouch.errors import CloudError, ConfigError
from foretouch.types import Cloud

_Z = np.array([0.1, 0.16, 1.0, 2.0, 2.1, np.nan, np.inf, -np.inf, -1.0], np.float32)


def _cloud() -> Cloud:
    xyz = np.zeros((len(_Z), 3), np.float32)
    xyz[:, 2] = _Z
    return Cloud(xyz, np.repeat(np.arange(len(_Z), dtype=np.uint8)[:, None], 3, axis=1), "camera", 7)


def test_the_range_includes_its_ends() -> None:
    np.testing.assert_array_equal(np.flatnonzero(in_range(_Z, CropConfig())), [1, 2, 3])


def test_crop_keeps_order_colour_frame_and_stamp() -> None:
    cropped = crop_range(_cloud(), CropConfig(min_range_m=0.5))
    np.testing.assert_array_equal(cropped.xyz[:, 2], [1.0, 2.0])
    np.testing.assert_array_equal(cropped.rgb[:, 0], [2, 3])
    assert (cropped.frame_id, cropped.stamp_ns) == ("camera", 7)


def test_crop_drops_points_of_which_any_coordinate_is_not_finite() -> None:
    cloud = _cloud()
    cloud.xyz[2, 0] = np.nan
    cloud.xyz[3, 1] = np.inf
    assert crop_range(cloud, CropConfig()).size == 1


def test_organised_clouds_become_a_list() -> None:
    cloud = Cloud(np.ones((3, 4, 3), np.float32))
    assert crop_range(cloud, CropConfig()).xyz.shape == (12, 3)
    assert crop_box(cloud, (2, 2, 2), (3, 3, 3)).xyz.shape == (0, 3)


def test_a_box_includes_its_faces(rng: np.random.Generator) -> None:
    xyz = rng.uniform(-1, 1, (1000, 3)).astype(np.float32)
    xyz[0] = (-0.5, 0.0, 0.25)
    cropped = crop_box(Cloud(xyz), (-0.5, 0.0, 0.25), (0.5, 0.5, 0.75))
    expected = [p for p in xyz if -0.5 <= p[0] <= 0.5 and 0 <= p[1] <= 0.5 and 0.25 <= p[2] <= 0.75]
    np.testing.assert_array_equal(cropped.xyz, expected)


@pytest.mark.parametrize("corners", [((0, 0, 1), (1, 1, 0)), ((0, 0), (1, 1)), ((0, 0, np.nan), (1, 1, 1))])
def test_corners_that_span_no_box_are_refused(corners) -> None:
    with pytest.raises(CloudError, match="two corners"):
        crop_box(_cloud(), *corners)


def test_a_range_of_nothing_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"min_range_m: 1\.5 is not below max_range_m 1\.0"):
        CropConfig(min_range_m=1.5, max_range_m=1.0)
