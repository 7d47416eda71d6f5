# SPDX-License-Identifier: Apache-2.0
"""What splitting costs in time: F against the time of segmentation, over the angle, the image's resolution and the smoothing."""

from collections.abc import Mapping, Sequence
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any, Final

import numpy as np

from benchmarks.clutter.metrics import SceneScore, score, summary
from benchmarks.clutter.scenes import LabelledCloud, segment_anew
from benchmarks.common import cpu_ms, print_rows, write_csv
from foretouch.cloud.segmentation.segment import SegmentationConfig, segment
from foretouch.types import Cloud

CSV: Final = Path(__file__).with_suffix(".csv")
OFF: Final = 180.0  # angle that does not split [deg]
ANGLES: Final = (OFF, 20.0, 29.0)
STRIDES: Final = {1: "all", 2: "every second"}  # of rows and columns, with their names
CELLS_M: Final = (0.003, 0.0045, 0.008)  # over which the surface is averaged
CLOSE: Final = 0.01  # so much less than the best may the F of the knee be
_SCORED: Final = 2  # rows and columns: F is measured on every second, which all resolutions have
_REPEATS: Final = 3  # the least time counts


def run(sets: Mapping[str, Sequence[LabelledCloud]], *, write: bool) -> None:
    """Measure and print; write the table where asked."""
    rows = measure(sets)
    print_rows(rows)
    if write:
        write_csv(CSV, rows)
        draw(rows, CSV.with_suffix(".png"))


def draw(rows: Sequence[Mapping[str, str]], path: Path) -> None:
    """Draw the F of each set against time, a marker for each setting, and the frontier as a line."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(7, 4), layout="constrained")
    times = np.array([float(row["time"]) for row in rows])
    for name in (column for column in rows[0] if column.startswith("f_")):
        values = np.array([float(row[name]) for row in rows])
        (line,) = axes.plot(times, values, "o", ms=4, label=name.removeprefix("f_"))
        best = values >= np.maximum.accumulate(values)
        axes.plot(times[best], values[best], color=line.get_color(), lw=1)
    for row in rows:
        if row["place"] == "knee":
            axes.axvline(float(row["time"]), color="0.6", ls=":", label="knee")
    axes.set(xlabel="time, relative to clusters alone on all pixels", ylabel="overlap F")
    axes.legend()
    figure.savefig(path, dpi=120)
    plt.close(figure)


def measure(sets: Mapping[str, Sequence[LabelledCloud]]) -> list[dict[str, Any]]:
    """A row for each setting, the fastest first, measured in turn for each scene; times relative to no splitting of all pixels.

    `place` names the knee, the fastest setting whose mean F of the sets is hardly lower than the best, and the others that
    no setting exceeds in F without being slower.
    """
    usual = SegmentationConfig().split.cell_m  # without splitting there is nothing to average
    tried = [one for one in product(ANGLES, STRIDES, CELLS_M) if one[0] < OFF or one[2] == usual]
    times: list[list[float]] = [[] for _ in tried]
    scores: list[dict[str, list[SceneScore]]] = [{name: [] for name in sets} for _ in tried]
    for name, scenes in sets.items():
        for scene in scenes:
            depth, true = np.isfinite(scene.cloud.xyz[..., 2])[::_SCORED, ::_SCORED], scene.labels[::_SCORED, ::_SCORED]
            for k, (angle, stride, cell_m) in enumerate(tried):
                config = SegmentationConfig().updated({"split.angle_deg": angle, "split.cell_m": cell_m})
                cloud, step = Cloud(np.ascontiguousarray(scene.cloud.xyz[::stride, ::stride])), _SCORED // stride
                labels = np.ascontiguousarray(segment(cloud, config).labels[::step, ::step])
                both = (np.where(depth, one, 0).astype(np.int32) for one in (labels, true))
                scores[k][name].append(score(*both))
                times[k].append(min(cpu_ms(partial(segment_anew, cloud, config), 1) for _ in range(_REPEATS)))
    ms = [float(np.median(some)) for some in times]
    means = [{name: summary(some) for name, some in of_sets.items()} for of_sets in scores]
    mean_f = [float(np.mean([mean["f"] for mean in one.values()])) for one in means]
    knee = min((k for k in range(len(tried)) if mean_f[k] >= max(mean_f) - CLOSE), key=ms.__getitem__)
    rows = []
    for k in np.argsort(ms).tolist():
        angle, stride, cell_m = tried[k]
        exceeded = any(mean_f[i] >= mean_f[k] and ms[i] <= ms[k] for i in range(len(tried)) if i != k)
        rows.append(
            {"angle_deg": "off" if angle == OFF else f"{angle:g}", "pixels": STRIDES[stride], "cell_mm": f"{1e3 * cell_m:g}"}
            | {f"{what}_{name}": f"{mean[what]:.3f}" for what in ("f", "found") for name, mean in means[k].items()}
            | {"time": f"{ms[k] / ms[tried.index((OFF, 1, usual))]:.2f}"}
            | {"place": "knee" if k == knee else "" if exceeded else "frontier"}
        )  # fmt: skip
    return rows
