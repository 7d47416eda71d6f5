# SPDX-License-Identifier: Apache-2.0
"""Each filter, through the library's own software device, does what its name says."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from every_case import every_case

from foretouch.camera.config import (
    DecimationConfig,
    FilterConfig,
    HoleFillingConfig,
    RealSenseConfig,
    SpatialConfig,
    TemporalConfig,
)
from foretouch.camera.device import realsense
from foretouch.camera.realsense import RealSenseCamera
from foretouch.camera.stream import FilterChain
from foretouch.camera.synthetic import SyntheticCamera
from foretouch.config import setting_infos
from foretouch.types import Cloud


@dataclass(frozen=True)
class _Frame:
    depth_mm: np.ndarray
    rgb: np.ndarray
    K: np.ndarray


def _clouds(frames: list[Any], config: RealSenseConfig, filters: dict[str, Any]) -> list[Cloud]:
    """One cloud a frame."""
    source = SyntheticCamera(frames)
    clouds = []
    with RealSenseCamera(config.replace(filters=FilterConfig(**filters)), source) as camera:
        assert camera.read(0.0) is None  # opens
        for _ in frames:
            source.feed()
            cloud = camera.read(1.0)
            assert cloud is not None, camera.status
            clouds.append(cloud)
    source.close()
    return clouds


def test_without_filters_the_depth_is_untouched_and_decimation_halves_the_image(images, config):
    assert FilterChain(FilterConfig())._blocks == []
    for cloud, image in zip(_clouds(list(images), config, {}), images, strict=True):
        assert np.array_equal(cloud.xyz, image.cloud().xyz, equal_nan=True)
    (cloud,) = _clouds([images[0]], config, {"decimation": DecimationConfig(enabled=True, magnitude=2)})
    assert cloud.xyz.shape == (120, 212, 3)
    plane, on_table = images[0].plane, (images[0].labels == 1)[::2, ::2]
    heights = np.abs(cloud.xyz.astype(np.float64) @ plane[:3] + plane[3])[on_table]
    # Merged blocks stay on the table, for the lens was scaled with the image: up to the middle of a block, a pixel away.
    pixel_m = np.nanmax(cloud.xyz[..., 2][on_table]) / images[0].K[0, 0]
    assert np.nanquantile(heights, 0.9) < 2.0 * pixel_m


def test_bounds_and_defaults_are_the_librarys_and_every_setting_reaches_it() -> None:
    def check(block: str, settings: Any, options: dict[str, str]) -> None:
        rs = realsense()
        filter_block = getattr(rs, block)()
        infos = {info.name: info for info in setting_infos(settings)}
        assert set(infos) == {"enabled", *options}
        for name, option in options.items():
            theirs = filter_block.get_option_range(getattr(rs.option, option))
            ours = infos[name]
            assert (ours.minimum, ours.maximum) == (theirs.min, theirs.max), name
            assert ours.default == pytest.approx(theirs.default), name

    smoothing = {"smooth_alpha": "filter_smooth_alpha", "smooth_delta": "filter_smooth_delta"}
    cases = [
        ("decimation_filter", DecimationConfig, {"magnitude": "filter_magnitude"}),
        ("spatial_filter", SpatialConfig, {"magnitude": "filter_magnitude", **smoothing}),
        ("temporal_filter", TemporalConfig, smoothing),
        ("hole_filling_filter", HoleFillingConfig, {"mode": "holes_fill"}),
    ]
    every_case(cases, check)
    chain = FilterChain(
        FilterConfig(
            decimation=DecimationConfig(enabled=True, magnitude=3),
            spatial=SpatialConfig(enabled=True, magnitude=4, smooth_alpha=0.3, smooth_delta=11),
            temporal=TemporalConfig(enabled=True, smooth_alpha=0.2, smooth_delta=33),
            hole_filling=HoleFillingConfig(enabled=True, mode=2),
        )
    )
    kinds = [type(block).__name__ for block in chain._blocks]
    smoothing = ["disparity_transform", "spatial_filter", "temporal_filter", "disparity_transform"]
    assert kinds == ["decimation_filter", *smoothing, "hole_filling_filter"]
    decimation, _, spatial, temporal, _, holes = chain._blocks
    option = realsense().option
    amounts = (option.filter_magnitude, option.filter_smooth_alpha, option.filter_smooth_delta)
    assert decimation.get_option(option.filter_magnitude) == 3
    assert [spatial.get_option(one) for one in amounts] == pytest.approx([4, 0.3, 11])
    assert [temporal.get_option(one) for one in amounts[1:]] == pytest.approx([0.2, 33])
    assert holes.get_option(option.holes_fill) == 2
