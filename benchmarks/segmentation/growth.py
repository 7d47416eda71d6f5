# SPDX-License-Identifier: Apache-2.0
"""How do the stages of segmentation and of GeoGrasp grow with the number of points? See README.md."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import numpy as np

from foretouch.cloud.segmentation.segment import segment
from foretouch.grasp import GeoGraspConfig, plan_grasps
from foretouch.simulation.depth_scene import random_scene
from foretouch.types import Cloud, Plane

SCENES = ((260, 195), (368, 276), (520, 390), (848, 480), (960, 540), (1280, 720))  # 50k to 900k points
OBJECT_POINTS = (1000, 2000, 4000, 7000, 10_000, 14_000, 20_000)
OBJECT = (1100, 825)  # pixels of the image whose largest object is sampled
_LEAST_MS = 0.02  # of a stage; the clock and Python's own calls dominate shorter ones


def stages(run: Callable[[], dict[str, float]], repeats: int) -> dict[str, float]:
    """Least CPU time of each stage [ms]: other load can only increase it."""
    runs = [run() for _ in range(repeats)]
    return {name: min(one[name] for one in runs) for name in runs[0]}


def show(title: str, sizes: list[int], times: list[dict[str, float]]) -> None:
    """Print the times and the exponents of t = a n^b, fitted in logarithms."""
    print(f"\n{title:<12}" + "".join(f"{size:>9}" for size in sizes) + f"{'exponent':>10}")
    for name in times[0]:
        values = np.array([one.get(name, np.nan) for one in times])
        exponent = np.polyfit(np.log(sizes), np.log(np.maximum(values, 1e-6)), 1)[0]
        text = f"{exponent:>10.2f}" if values.max() >= _LEAST_MS else f"{'-':>10}"
        print(f"{name:<12}" + "".join(f"{value:>9.3f}" for value in values) + text)


def object_of(points: int) -> tuple[Cloud, Plane, np.ndarray, tuple[int, int]]:
    """An object of about so many points: the largest of a scene, seen by a camera of a resolution that gives them."""
    scale = 1.0
    for _ in range(6):
        size = (round(OBJECT[0] * scale), round(OBJECT[1] * scale))
        rng = np.random.default_rng(1)
        found = segment(random_scene(rng, *size).render(rng, 0.0005, False).cloud())
        largest = max(found.objects, key=lambda one: one.n_points)
        scale *= float(np.sqrt(points / largest.n_points))
    assert found.plane is not None
    return largest.cloud, found.plane, largest.pixels, (size[1], size[0])


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=15)
    repeats = parser.parse_args().repeats
    time.perf_counter = time.thread_time  # with which the stages measure: CPU time is that of an idle machine
    times = []
    for size in SCENES:
        rng = np.random.default_rng(1)
        cloud = random_scene(rng, *size).render(rng, 0.0015, True).cloud()
        times.append(stages(lambda cloud=cloud: segment(Cloud(cloud.xyz.copy())).ms, repeats))  # type: ignore[misc]
    show("scene [ms]", [width * height for width, height in SCENES], times)
    for method, most in (("original", 8000), ("stable", 8000), ("original", 0), ("stable", 0)):
        config = GeoGraspConfig(method=method, max_points=most)  # type: ignore[arg-type]
        sizes, times = [], []
        for points in OBJECT_POINTS:
            cloud, plane, pixels, shape = object_of(points)
            sizes.append(cloud.size)
            times.append(
                stages(lambda: plan_grasps(cloud, plane, config, pixels=pixels, image_shape=shape).ms, repeats)  # noqa: B023
            )
        print(f"\n{method}, max_points {most}")
        show("object [ms]", sizes, times)


if __name__ == "__main__":
    main()
