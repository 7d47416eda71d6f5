# SPDX-License-Identifier: Apache-2.0
"""Each filter, through the library's own software device, does what its name says."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from foretouch.camera import FilterConfig, RealSenseConfig, SyntheticCamera, open_camera
from foretouch.camera.config import DecimationConfig, HoleFillingConfig, SpatialConfig, TemporalConfig
from foretouch.camera.device import realsense
from foretouch.camera.stream import FilterChain
from foretouch.config import setting_infos
from foretouch.simulation import DepthImage
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
    with open_camera(config.replace(filters=FilterConfig(**filters)), source) as camera:
        assert camera.read(0.0) is None  # opens
        for _ in frames:
            source.feed()
            cloud = camera.read(1.0)
            assert cloud is not None, camera.status
            clouds.append(cloud)
    source.close()
    return clouds


def test_without_filters_the_chain_is_empty_and_the_depth_untouched(
    images: list[DepthImage], config: RealSenseConfig
) -> None:
    assert len(FilterChain(FilterConfig())) == 0
    for cloud, image in zip(_clouds(list(images), config, {}), images, strict=True):
        assert np.array_equal(cloud.xyz, image.cloud().xyz, equal_nan=True)


def test_decimation_halves_the_image_and_keeps_the_scene(images: list[DepthImage], config: RealSenseConfig) -> None:
    (cloud,) = _clouds([images[0]], config, {"decimation": DecimationConfig(enabled=True, magnitude=2)})
    assert cloud.xyz.shape == (120, 212, 3)
    plane, K = images[0].plane, images[0].K
    on_table = images[0].labels == 1
    heights = np.abs(cloud.xyz.astype(np.float64) @ plane[:3] + plane[3])[on_table[::2, ::2]]
    # Merged blocks stay on the table, for the lens was scaled with the image: up to the middle of a block, a pixel away.
    pixel_m = np.nanmax(cloud.xyz[..., 2][on_table[::2, ::2]]) / K[0, 0]
    assert np.nanquantile(heights, 0.9) < 2.0 * pixel_m


@pytest.mark.parametrize("disparity", [True, False])
def test_spatial_and_temporal_smoothing_lower_the_noise(
    images: list[DepthImage], config: RealSenseConfig, rng: np.random.Generator, disparity: bool
) -> None:
    exact = np.full((240, 424), 1000, np.uint16)
    noise = [np.rint(exact + rng.normal(0.0, 4.0, exact.shape)).astype(np.uint16) for _ in range(6)]
    frames = [_Frame(z, images[0].rgb, images[0].K) for z in noise]
    spread = {
        name: float(np.nanstd(_clouds(frames, config, {"disparity": disparity, **on})[-1].xyz[20:-20, 20:-20, 2]))
        for name, on in {
            "off": {},
            "spatial": {"spatial": SpatialConfig(enabled=True)},
            "temporal": {"temporal": TemporalConfig(enabled=True)},
        }.items()
    }
    assert spread["off"] == pytest.approx(0.004, rel=0.1)
    assert spread["spatial"] < 0.6 * spread["off"]
    assert spread["temporal"] < 0.7 * spread["off"]


@pytest.mark.parametrize(("mode", "expected"), [(0, 0.9), (1, 1.0), (2, 0.9)])
def test_a_hole_is_filled_from_the_left_the_farthest_or_the_nearest(
    mode: int, expected: float, images: list[DepthImage], config: RealSenseConfig
) -> None:
    depth = np.full((240, 424), 1000, np.uint16)
    depth[:, :199] = 900
    depth[100, 199] = 0
    frame = _Frame(depth, images[0].rgb, images[0].K)
    (cloud,) = _clouds([frame], config, {"hole_filling": HoleFillingConfig(enabled=True, mode=mode)})
    assert cloud.xyz[100, 199, 2] == pytest.approx(expected, abs=1e-6)
    (unfilled,) = _clouds([frame], config, {})
    assert np.isnan(unfilled.xyz[100, 199]).all()


@pytest.mark.parametrize(
    ("settings", "block", "options"),
    [
        (DecimationConfig, "decimation_filter", {"magnitude": "filter_magnitude"}),
        (
            SpatialConfig,
            "spatial_filter",
            {
                "magnitude": "filter_magnitude",
                "smooth_alpha": "filter_smooth_alpha",
                "smooth_delta": "filter_smooth_delta",
                "holes_fill": "holes_fill",
            },
        ),
        (
            TemporalConfig,
            "temporal_filter",
            {"smooth_alpha": "filter_smooth_alpha", "smooth_delta": "filter_smooth_delta", "persistence": "holes_fill"},
        ),
        (HoleFillingConfig, "hole_filling_filter", {"mode": "holes_fill"}),
    ],
)
def test_bounds_and_defaults_are_the_librarys(settings: Any, block: str, options: dict[str, str]) -> None:
    rs = realsense()
    filter_block = getattr(rs, block)()
    infos = {info.name: info for info in setting_infos(settings)}
    assert set(infos) == {"enabled", *options}
    for name, option in options.items():
        theirs = filter_block.get_option_range(getattr(rs.option, option))
        ours = infos[name]
        assert (ours.minimum, ours.maximum) == (theirs.min, theirs.max), name
        assert ours.default == pytest.approx(theirs.default), name


def test_every_setting_reaches_the_library() -> None:
    rs = realsense()
    chain = FilterChain(
        FilterConfig(
            decimation=DecimationConfig(enabled=True, magnitude=3),
            spatial=SpatialConfig(enabled=True, magnitude=4, smooth_alpha=0.3, smooth_delta=11, holes_fill=2),
            temporal=TemporalConfig(enabled=True, smooth_alpha=0.2, smooth_delta=33, persistence=7),
            hole_filling=HoleFillingConfig(enabled=True, mode=2),
        )
    )
    kinds = [type(block).__name__ for block in chain._blocks]
    assert kinds == [
        "decimation_filter",
        "disparity_transform",
        "spatial_filter",
        "temporal_filter",
        "disparity_transform",
        "hole_filling_filter",
    ]
    decimation, _, spatial, temporal, _, holes = chain._blocks
    option = rs.option
    assert decimation.get_option(option.filter_magnitude) == 3
    assert [
        spatial.get_option(o) for o in (option.filter_magnitude, option.filter_smooth_delta, option.holes_fill)
    ] == [4, 11, 2]
    assert spatial.get_option(option.filter_smooth_alpha) == pytest.approx(0.3)
    assert [temporal.get_option(o) for o in (option.filter_smooth_delta, option.holes_fill)] == [33, 7]
    assert temporal.get_option(option.filter_smooth_alpha) == pytest.approx(0.2)
    assert holes.get_option(option.holes_fill) == 2


def test_without_disparity_the_filters_see_millimetres() -> None:
    on = FilterConfig(spatial=SpatialConfig(enabled=True), disparity=False)
    assert len(FilterChain(on)) == 1
    assert len(FilterChain(dataclasses.replace(on, disparity=True))) == 3
