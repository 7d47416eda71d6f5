# SPDX-License-Identifier: Apache-2.0
"""Whole images that others took, with walls, robots and a second table in view: what is found, and what is no object.

`python -m benchmarks.clutter.whole FOLDER` prints a row for each image, or kind of image (`--kinds`); `--pictures FOLDER` draws the worst ones.
"""

import argparse
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from benchmarks.clutter.metrics import FOUND, SceneScore, f_of_best, score, summary
from benchmarks.clutter.scenes import LabelledCloud, load_scenes
from benchmarks.common import cpu_ms, print_rows
from foretouch.pipeline import Pipeline
from foretouch.types.scene import Scene

_WORST: Final = 6  # images that are drawn


def rows(scenes: Sequence[LabelledCloud]) -> list[dict[str, Any]]:
    """A row for each image, the worst first, and one for all."""
    answers = [answer(scene) for scene in scenes]
    table = [row(scene.name, [answer]) for scene, answer in zip(scenes, answers, strict=True)]
    table.sort(key=lambda row: (row["target"] - row["none"] - row["cut"] - row["merged"] + row["found"] - row["objects"], row["images"]))  # fmt: skip
    return [*table, row("all", answers)]


def kinds(scenes: Iterable[LabelledCloud]) -> list[dict[str, Any]]:
    """A row for each kind of scene, and one for all."""
    answers: dict[str, list[tuple[SceneScore, bool, float]]] = {}
    for scene in scenes:
        answers.setdefault(scene.kind, []).append(answer(scene))
    every = [answer for some in answers.values() for answer in some]
    rows = [{"rooms": kind, "count": len(some), **row(kind, some)} for kind, some in [*answers.items(), ("all", every)]]
    return [{name: value for name, value in row.items() if name != "images"} for row in rows]


def answer(scene: LabelledCloud) -> tuple[SceneScore, bool, float]:
    """The score, whether the default target is one whole object, and the least CPU time of three calls [ms]."""
    pipeline = Pipeline()
    result = pipeline.segment(scene.cloud)
    labels = result.labels
    true = np.where(np.isfinite(scene.cloud.xyz[..., 2]), scene.labels, 0).astype(np.int32)
    whole = any(f_of_best(labels == int(target.id), true) >= FOUND for target in result.targets)
    return score(labels, true), whole, cpu_ms(lambda: pipeline.segment(scene.cloud), 3, least=True)


def row(name: str, answers: Sequence[tuple[SceneScore, bool, float]]) -> dict[str, Any]:
    scores = [one for one, *_ in answers]
    return {
        "images": name,
        "objects": sum(one.n_true for one in scores),
        "found": sum(one.n_found for one in scores),
        "cut": sum(one.n_cut for one in scores),
        "merged": sum(one.n_merged for one in scores),
        "none": sum(one.n_none for one in scores),
        "target": sum(whole for _, whole, _ in answers),
        "f": round(summary(scores)["f"], 3),
        "ms": round(float(np.median([ms for *_, ms in answers])), 1),
    }


def draw(scene: LabelledCloud, result: Scene, path: Path) -> None:
    """Draw the depth with the segments in colour and the outlines of the true objects in white; the target has a star."""
    import matplotlib.pyplot as plt

    depth, labels = scene.cloud.xyz[..., 2], result.labels
    figure, axes = plt.subplots(figsize=(8, 8 * depth.shape[0] / depth.shape[1]), layout="constrained")
    axes.imshow(depth, cmap="gray", vmin=np.nanpercentile(depth, 1), vmax=np.nanpercentile(depth, 98))
    axes.imshow(np.where(labels > 0, labels * 7 % 20, np.nan), cmap="tab20", vmin=0, vmax=19, alpha=0.6)
    for label in range(1, int(scene.labels.max()) + 1):
        axes.contour(scene.labels == label, [0.5], colors="white", linewidths=0.8)
    for object_ in result.objects:
        row, column = np.median(np.unravel_index(object_.pixels, labels.shape), axis=1)
        star = "*" if object_.id in {target.id for target in result.targets} else ""
        axes.text(column, row, f"{object_.id}{star}", color="white", ha="center", va="center")
    axes.set_title(f"{scene.name}: {result.status} {result.reason}"[:100], fontsize=8)
    axes.set_axis_off()
    figure.savefig(path, dpi=110)
    plt.close(figure)


def main() -> None:
    """Print the rows; draw the worst images if asked."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="labelled images (.npz)")
    parser.add_argument("--pictures", type=Path, help="folder for pictures of the worst images")
    parser.add_argument("--kinds", action="store_true", help="a row for each kind of scene instead")
    options = parser.parse_args()
    scenes = {scene.name: scene for scene in load_scenes(options.folder)}
    table = rows(list(scenes.values())) if options.pictures or not options.kinds else []
    print_rows(kinds(scenes.values()) if options.kinds else table)
    if options.pictures:
        options.pictures.mkdir(parents=True, exist_ok=True)
        for row in table[:_WORST]:
            if (scene := scenes.get(row["images"])) is not None:
                draw(scene, Pipeline().segment(scene.cloud), options.pictures / f"{scene.name}.png")


if __name__ == "__main__":
    main()
