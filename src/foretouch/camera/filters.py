# SPDX-License-Identifier: Apache-2.0
"""The library's post-processing filters as one chain."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from foretouch.camera.config import FilterConfig
from foretouch.camera.library import realsense

__all__ = ["FilterChain"]


class FilterChain:
    """Runs the enabled filters in the order that the library recommends.

    The temporal filter stores earlier frames, so that each stream needs a separate chain.
    """

    def __init__(self, config: FilterConfig) -> None:
        rs = realsense()
        option = rs.option
        self._blocks: list[Any] = []
        if config.decimation.enabled:
            self._add(rs.decimation_filter(), {option.filter_magnitude: config.decimation.magnitude})
        smoothing = config.spatial.enabled or config.temporal.enabled
        if smoothing and config.disparity:
            self._add(rs.disparity_transform(True))
        if config.spatial.enabled:
            self._add(
                rs.spatial_filter(),
                {
                    option.filter_magnitude: config.spatial.magnitude,
                    option.filter_smooth_alpha: config.spatial.smooth_alpha,
                    option.filter_smooth_delta: config.spatial.smooth_delta,
                    option.holes_fill: config.spatial.holes_fill,
                },
            )
        if config.temporal.enabled:
            self._add(
                rs.temporal_filter(),
                {
                    option.filter_smooth_alpha: config.temporal.smooth_alpha,
                    option.filter_smooth_delta: config.temporal.smooth_delta,
                    option.holes_fill: config.temporal.persistence,
                },
            )
        if smoothing and config.disparity:
            self._add(rs.disparity_transform(False))
        if config.hole_filling.enabled:
            self._add(rs.hole_filling_filter(), {option.holes_fill: config.hole_filling.mode})

    def __len__(self) -> int:
        """Number of processing blocks, the conversions to disparity and back included."""
        return len(self._blocks)

    def process(self, frames: Any) -> Any:
        """Filter the depth of a frameset; colour is only decimated, where the library does so."""
        for block in self._blocks:
            frames = block.process(frames).as_frameset()
        return frames

    def _add(self, block: Any, options: Mapping[Any, float] | None = None) -> None:
        for name, value in (options or {}).items():
            block.set_option(name, float(value))
        self._blocks.append(block)
