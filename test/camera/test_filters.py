# SPDX-License-Identifier: Apache-2.0
"""Each filter, through the library's own software device, does what its name says."""

from typing import Any

import numpy as np
from every_case import every_case

from foretouch.camera.config import RealSenseConfig
from foretouch.camera.realsense import RealSenseCamera
from foretouch.camera.stream import filter_blocks
from foretouch.types import Cloud
from foretouch_lab.simulation.software_camera import SyntheticCamera


def _clouds(frames: list[Any], config: RealSenseConfig, *filters: str) -> list[Cloud]:
    """One cloud a frame."""
    source = SyntheticCamera(frames)
    clouds = []
    with RealSenseCamera(config.replace(filters=filters), source) as camera:
        assert camera.read(0.0) is None  # opens
        for _ in frames:
            source.feed()
            cloud = camera.read(1.0)
            assert cloud is not None, camera.status
            clouds.append(cloud)
    source.close()
    return clouds


def test_without_filters_the_depth_is_untouched_and_decimation_halves_the_image(images, config):
    for cloud, image in zip(_clouds(list(images), config), images, strict=True):
        assert np.array_equal(cloud.xyz, image.cloud().xyz, equal_nan=True)
    (cloud,) = _clouds([images[0]], config, "decimation")
    assert cloud.xyz.shape == (120, 212, 3)
    plane, on_table = images[0].plane, (images[0].labels == 1)[::2, ::2]
    heights = np.abs(cloud.xyz.astype(np.float64) @ plane[:3] + plane[3])[on_table]
    # Merged blocks stay on the table, for the lens was scaled with the image: up to the middle of a block, a pixel away.
    pixel_m = np.nanmax(cloud.xyz[..., 2][on_table]) / images[0].K[0, 0]
    assert np.nanquantile(heights, 0.9) < 2.0 * pixel_m


def test_filters_run_in_the_order_of_the_library_and_smoothing_on_disparity() -> None:
    def check(names: str, kinds: str) -> None:
        assert [type(block).__name__ for block in filter_blocks(names.split())] == kinds.split()

    every_case(
        [
            ("", ""),
            ("hole_filling decimation", "decimation_filter hole_filling_filter"),
            ("temporal", "disparity_transform temporal_filter disparity_transform"),
            (
                "hole_filling temporal spatial decimation",
                "decimation_filter disparity_transform spatial_filter temporal_filter disparity_transform hole_filling_filter",
            ),
        ],
        check,
    )
