# SPDX-License-Identifier: Apache-2.0
"""What splitting costs in time: F against the time of segmentation, over the angle, the image's resolution and the smoothing."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import Final

import numpy as np

from benchmarks.clutter.metrics import SceneScore, score, summary
from benchmarks.clutter.scenes import LabelledCloud
from benchmarks.common import cpu_ms, print_rows, write_csv
from foretouch.cloud.segmentation.segment import SegmentationConfig, segment
from foretouch.report.panels import new_figure, save_small
from foretouch.types import Cloud

HERE: Final = Path(__file__).parent
CSV, PICTURE = HERE / "frontier.csv", HERE / "frontier.png"
ANGLES: Final = (180.0, 20.0, 29.0)  # degrees; the first does not split
STRIDES: Final = (1, 2)  # every pixel, or every second of rows and columns
CELLS_M: Final = (0.0035, 0.005, 0.008)  # over which the surface is averaged
CLOSE: Final = 0.01  # so much less than the best may the F of the knee be
_SCORED: Final = 2  # rows and columns: F is measured on every second, which all resolutions have
_REPEATS: Final = 3  # the least time counts


@dataclass(frozen=True)
class Setting:
    """What is varied."""

    angle_deg: float
    stride: int
    cell_m: float

    @property
    def config(self) -> SegmentationConfig:
        """The defaults with these settings."""
        return SegmentationConfig().updated({"split.angle_deg": self.angle_deg, "split.cell_m": self.cell_m})


@dataclass(frozen=True)
class Point:
    """A setting and what it reaches."""

    setting: Setting
    f: Mapping[str, float]  # by set of scenes
    found: Mapping[str, float]
    ms: float  # CPU, median over scenes

    @property
    def mean_f(self) -> float:
        """Of the sets, each with equal weight."""
        return float(np.mean(list(self.f.values())))


def settings() -> list[Setting]:
    """All that are measured; without splitting there is nothing to average."""
    every = product(ANGLES, STRIDES, CELLS_M)
    return [Setting(*one) for one in every if one[0] < 180.0 or one[2] == SegmentationConfig().split.cell_m]


def run(sets: Mapping[str, Sequence[LabelledCloud]], *, write: bool) -> None:
    """Measure and print; write table and picture where asked."""
    points = list(measure(sets))
    print_rows(table(points))
    print(f"\nThe knee: {_name(knee_of(points).setting)}")
    if write:
        write_csv(CSV, table(points))
        draw(points, PICTURE)


def measure(sets: Mapping[str, Sequence[LabelledCloud]]) -> Iterator[Point]:
    """All settings on all scenes, in turn for each scene."""
    tried = settings()
    times: list[list[float]] = [[] for _ in tried]
    scores: list[dict[str, list[SceneScore]]] = [{name: [] for name in sets} for _ in tried]
    for name, scenes in sets.items():
        for scene in scenes:
            depth, true = np.isfinite(scene.cloud.xyz[..., 2])[::_SCORED, ::_SCORED], scene.labels[::_SCORED, ::_SCORED]
            for k, one in enumerate(tried):
                xyz = np.ascontiguousarray(scene.cloud.xyz[:: one.stride, :: one.stride])
                step = _SCORED // one.stride
                labels = np.ascontiguousarray(segment(Cloud(xyz), one.config).labels[::step, ::step])
                scores[k][name].append(
                    score(np.where(depth, labels, 0).astype(np.int32), np.where(depth, true, 0).astype(np.int32))
                )
                job = partial(_again, Cloud(xyz), one.config)
                times[k].append(min(cpu_ms(job, 1) for _ in range(_REPEATS)))
    for one, of_sets, ms in zip(tried, scores, times, strict=True):
        means = {name: summary(some) for name, some in of_sets.items()}
        columns = ({name: mean[what] for name, mean in means.items()} for what in ("f", "found"))
        yield Point(one, *columns, float(np.median(ms)))


def _again(cloud: Cloud, config: SegmentationConfig) -> None:
    """Segment a new copy of the cloud, as from a camera."""
    segment(replace(cloud, xyz=cloud.xyz.copy()), config)


def knee_of(points: Sequence[Point]) -> Point:
    """The fastest setting whose F is hardly lower than the best."""
    best = max(point.mean_f for point in points)
    return min((point for point in points if point.mean_f >= best - CLOSE), key=lambda point: point.ms)


def on_frontier(point: Point, points: Sequence[Point]) -> bool:
    """Whether no other reaches as much in less time, or more in the same time."""
    return not any(other.mean_f >= point.mean_f and other.ms <= point.ms and other is not point for other in points)


def table(points: Sequence[Point]) -> list[dict[str, object]]:
    """A row for each setting, the fastest first; times as ratios to clusters alone at full resolution."""
    alone = _alone_ms(points)
    knee = knee_of(points)
    return [
        {
            "angle_deg": "off" if point.setting.angle_deg >= 180.0 else f"{point.setting.angle_deg:g}",
            "pixels": {1: "all", 2: "every second"}[point.setting.stride],
            "cell_mm": f"{1e3 * point.setting.cell_m:g}",
            **{f"f_{name}": f"{value:.3f}" for name, value in point.f.items()},
            **{f"found_{name}": f"{value:.3f}" for name, value in point.found.items()},
            "time": f"{point.ms / alone:.2f}",
            "place": "knee" if point is knee else "frontier" if on_frontier(point, points) else "",
        }
        for point in sorted(points, key=lambda point: point.ms)
    ]


def _alone_ms(points: Sequence[Point]) -> float:
    return next(point.ms for point in points if point.setting.angle_deg >= 180.0 and point.setting.stride == 1)


def _name(one: Setting) -> str:
    split = "no splitting" if one.angle_deg >= 180.0 else f"{one.angle_deg:g} degrees, cells of {1e3 * one.cell_m:g} mm"
    return f"{split}, {'all pixels' if one.stride == 1 else 'every second pixel'}"


def draw(points: Sequence[Point], path: Path) -> None:
    """Write the picture: a line for each angle and resolution, cells from large to small."""
    alone = _alone_ms(points)
    figure = new_figure(7.0, 4.2)
    axis = figure.subplots()
    for angle, stride in product(ANGLES, STRIDES):
        mine = [point for point in points if (point.setting.angle_deg, point.setting.stride) == (angle, stride)]
        mine.sort(key=lambda point: -point.setting.cell_m)
        label = f"{'no splitting' if angle >= 180.0 else f'{angle:g} degrees'}, {'all pixels' if stride == 1 else 'every second'}"
        axis.plot(
            [one.ms / alone for one in mine], [one.mean_f for one in mine], "o-" if stride == 1 else "s--", label=label
        )
    knee = knee_of(points)
    axis.plot(knee.ms / alone, knee.mean_f, "o", markersize=14, fillstyle="none", color="black", label="knee")
    axis.set(
        xlabel="CPU time of segmentation, relative to clusters alone on all pixels",
        ylabel="overlap F, mean of the sets",
    )
    axis.set_xlim(left=0.0)
    axis.grid(alpha=0.3)
    axis.legend(fontsize=7)
    save_small(figure, path)
