# SPDX-License-Identifier: Apache-2.0
"""What does a frame cost on its way from the camera's pixels to a cloud? See README.md."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from foretouch.camera import RealSenseConfig, SyntheticCamera
from foretouch.camera.config import DecimationConfig, FilterConfig, HoleFillingConfig, SpatialConfig, TemporalConfig
from foretouch.camera.device import realsense
from foretouch.camera.stream import Frames, FrameStream, lens_of
from foretouch.simulation import DepthImage, random_scene

SIZES = ((848, 480), (1280, 720))
REPEATS = 41


def cpu_ms(function: Callable[[], object]) -> float:
    """Median CPU time of a call, all threads of the process together [ms]."""
    times = []
    for _ in range(REPEATS):
        start = time.process_time()
        function()
        times.append((time.process_time() - start) * 1e3)
    return statistics.median(times)


def frames_of(source: SyntheticCamera, stream: FrameStream) -> Frames:
    """One frame through the library's software device."""
    source.feed()
    frames = stream.wait(2.0)
    if frames is None:
        raise RuntimeError("the software device sent nothing")
    return frames


def deprojection(image: DepthImage) -> None:
    """Ours against `rs.pointcloud`, equal first."""
    rs = realsense()
    height, width = image.depth_mm.shape
    source = SyntheticCamera([image])
    stream = FrameStream(source.find(), RealSenseConfig(width=width, height=height))
    depth: Any = frames_of(source, stream).depth.as_depth_frame()
    lens = lens_of(depth.get_profile().as_video_stream_profile().get_intrinsics())
    pointcloud = rs.pointcloud()

    def ours() -> np.ndarray:
        return lens.points(np.asanyarray(depth.get_data()), depth.get_units())

    def theirs() -> np.ndarray:
        vertices = np.asanyarray(pointcloud.calculate(depth).get_vertices(2))
        points = np.array(vertices).reshape(height, width, 3)  # copied: the frame takes its memory back
        points[points[..., 2] == 0.0] = np.nan  # the library's mark of no depth is the origin
        return points

    same = "equal" if np.array_equal(ours(), theirs(), equal_nan=True) else "DIFFERENT"
    print(f"{f'deproject, {width}x{height}':<34}{same:>12}{cpu_ms(ours):>9.2f}{cpu_ms(theirs):>15.2f}")
    stream.close()


def frame_cost(image: DepthImage, name: str, **settings: Any) -> None:
    """A whole frame, its feeding excepted."""
    height, width = image.depth_mm.shape
    source = SyntheticCamera([image])
    stream = FrameStream(source.find(), RealSenseConfig(width=width, height=height, **settings))
    frames = frames_of(source, stream)
    shape = stream.cloud(frames).xyz.shape
    cost = cpu_ms(lambda: stream.cloud(frames))
    print(f"{name:<34}{f'{shape[1]}x{shape[0]}':>12}{cost:>9.2f}")
    stream.close()


def main() -> None:
    """Print the tables."""
    images = [random_scene(np.random.default_rng(0), *size).render() for size in SIZES]
    print(f"{'':<34}{'points':>12}{'CPU ms':>9}{'rs.pointcloud':>15}")
    for image in images:
        deprojection(image)
    filters = {
        "decimation": FilterConfig(decimation=DecimationConfig(enabled=True)),
        "spatial": FilterConfig(spatial=SpatialConfig(enabled=True)),
        "temporal": FilterConfig(temporal=TemporalConfig(enabled=True)),
        "hole filling": FilterConfig(hole_filling=HoleFillingConfig(enabled=True)),
        "all four": FilterConfig(
            decimation=DecimationConfig(enabled=True),
            spatial=SpatialConfig(enabled=True),
            temporal=TemporalConfig(enabled=True),
            hole_filling=HoleFillingConfig(enabled=True),
        ),
    }
    for image, (width, height) in zip(images, SIZES, strict=True):
        print(f"\n{f'frame to cloud, {width}x{height}':<34}{'cloud':>12}{'CPU ms':>9}")
        frame_cost(image, "depth only")
        for align in ("colour_to_depth", "depth_to_colour"):
            frame_cost(image, align, align=align)
        for name, config in filters.items():
            frame_cost(image, name, filters=config)
    print(f"\n{'render a scene of 3 objects':<34}{'':>12}{'CPU ms':>9}")
    for width, height in SIZES:
        scene = random_scene(np.random.default_rng(0), width, height)
        print(f"{f'{width}x{height}':<34}{'':>12}{cpu_ms(scene.render):>9.2f}")


if __name__ == "__main__":
    main()
