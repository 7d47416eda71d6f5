# SPDX-License-Identifier: Apache-2.0
"""Is a segment one whole object as often as its confidence says, and is the target that it selects? See confidence.md.

The weights of `cloud/segmentation/objects.py` are fitted to all labelled images that are given, and judged with each source left out
in turn: a source is an image's origin (the word before the first _ in its name in `real_scenes`), OSD, the piles, or the rooms.
"""

import argparse
import itertools
import json
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import sklearn
from sklearn.linear_model import LogisticRegression

from benchmarks.clutter import piles, rooms
from benchmarks.clutter.bench import made
from benchmarks.clutter.metrics import FOUND, f_of_best
from benchmarks.clutter.scenes import LabelledCloud, load_scenes
from benchmarks.common import add_data, markdown, print_rows, replace_marked
from foretouch.cloud.segmentation import objects
from foretouch.cloud.segmentation.clusters import Clusters
from foretouch.cloud.segmentation.objects import TargetConfig, select_targets
from foretouch.cloud.segmentation.segment import segment
from foretouch.types import Bool, Float64
from foretouch.types.scene import Object

HERE: Final = Path(__file__).parent
_CONFIDENCE: Final = objects.confidence  # which a `Recorder` replaces
_IMAGES: Final = "images"  # the set whose images have sources of their own
_WEIGHT: Final = {_IMAGES: 6.0, "OSD": 2.0}  # of a segment: images of others are few, and what counts
_BINS: Final = (0.0, 0.5, 0.7, 0.8, 0.9, 0.95, 1.0)
_STRENGTH: Final = 0.3  # of the data against the prior that all weights are 0


@dataclass(frozen=True, eq=False)
class Segments:
    """The segments of a scene, in order of their distance from the camera."""

    set: str
    source: str
    objects: Sequence[Object]
    inputs: Float64  # (n, 3) of the regression
    scored: Bool  # (n,) most of their pixels are scored
    whole: Bool  # (n,) whether each is one object, with an F of FOUND or more


def labelled_sets(data: Path | None) -> dict[str, Path]:
    """Folders of labelled scenes; piles and rooms are those of the benchmark, made once."""
    given = {} if data is None else {_IMAGES: data / "real_scenes", "OSD": data / "osd"}
    return {name: folder for name, folder in given.items() if folder.is_dir()} | {
        "piles": made("piles", lambda out: piles.write_piles(out, 200, 0, data), 200, 0, str(data)),
        "rooms": made("rooms", lambda out: rooms.write_rooms(out, 84, 0, data), 84, 0, str(data)),
    }


class Recorder:
    """The confidence, called by segmentation, that keeps its inputs."""

    def __init__(self) -> None:
        self._inputs: list[list[float]] = []
        objects.confidence = self  # type: ignore[assignment]

    def __call__(self, window: Clusters, label: int, n_points: int) -> float | None:
        """Return the confidence of a segment, and keep what it comes from."""
        self._inputs.append(objects.inputs(window, label, n_points) or [math.nan] * len(objects.INPUTS))
        return _CONFIDENCE(window, label, n_points)

    def segments(self, name: str, scene: LabelledCloud) -> Segments:
        """Segment a scene, and compare its segments with the labels."""
        self._inputs.clear()
        found = segment(scene.cloud)
        true = np.where(np.isfinite(scene.cloud.xyz[..., 2]), scene.labels, 0)
        masks = [found.labels == int(one.id) for one in found.objects]
        scored = np.array([2 * np.count_nonzero(true[mask] < 0) <= np.count_nonzero(mask) for mask in masks], np.bool_)
        whole = np.array([f_of_best(mask, true) >= FOUND if (true > 0).any() else False for mask in masks], np.bool_)
        source = scene.name.split("_")[0] if name == _IMAGES else name
        return Segments(name, source, found.objects, np.reshape(self._inputs, (-1, 3)), scored, whole)


def fit(scenes: Sequence[Segments]) -> Float64:
    """Fit the weights of the inputs, and the constant (4,)."""
    x, y = np.concatenate([one.inputs[one.scored] for one in scenes]), _whole(scenes)
    weight = np.concatenate([np.full(np.count_nonzero(one.scored), _WEIGHT.get(one.set, 1.0)) for one in scenes])
    middle, spread = x.mean(axis=0), x.std(axis=0) + 1e-9
    model = LogisticRegression(C=_STRENGTH, max_iter=1000).fit((x - middle) / spread, y, sample_weight=weight)
    slopes = model.coef_[0] / spread
    return np.append(slopes, model.intercept_[0] - slopes @ middle)


Answer = tuple[Segments, Float64, float]
"""A scene, the confidence of its segments without its source, and the share of whole ones in the other sources."""


def left_out(scenes: Sequence[Segments]) -> Iterator[Answer]:
    """Iterate over each scene with the confidence of its segments by weights that its source was left out of, and the share of whole ones there."""
    for source in dict.fromkeys(one.source for one in scenes):
        others = [one for one in scenes if one.source != source]
        weights = fit(others)
        share = float(
            np.mean([_whole([one for one in others if one.set == name]).mean() for name in {one.set for one in others}])
        )
        for one in scenes:
            if one.source == source:
                yield one, 1.0 / (1.0 + np.exp(-(one.inputs @ weights[:3] + weights[3]))), share


def _whole(scenes: Iterable[Segments]) -> Float64:
    return np.concatenate([one.whole[one.scored] for one in scenes]).astype(np.float64)


def _is_whole(scene: Segments, sure: Float64 | None) -> bool:
    """Whether the default target is one whole object; the nearest without a confidence."""
    known = [None] * len(scene.objects) if sure is None else sure.tolist()
    chosen, _ = select_targets(
        [replace(one, confidence=p) for one, p in zip(scene.objects, known, strict=True)], TargetConfig()
    )
    return any(scene.whole[int(one.id) - 1] for one in chosen)


def rows(answers: Sequence[Answer]) -> list[dict[str, Any]]:
    """A row for each set: Brier scores of the confidence and of a constant, and default targets that are whole, by both."""
    table = []
    for name in dict.fromkeys(one.set for one, *_ in answers):
        some = [answer for answer in answers if answer[0].set == name]
        y, p = _whole(one for one, *_ in some), np.concatenate([sure[one.scored] for one, sure, _ in some])
        flat = np.concatenate([np.full(np.count_nonzero(one.scored), share) for one, _, share in some])
        with_any = [(one, sure) for one, sure, _ in some if len(one.objects)]
        table.append({
            "scenes": name,
            "segments": len(y),
            "whole": round(float(y.mean()), 3),
            "confidence": round(float(p.mean()), 3),
            "Brier": round(float(np.mean((p - y) ** 2)), 3),
            "Brier of a constant": round(float(np.mean((flat - y) ** 2)), 3),
            "targets": len(with_any),
            "whole, nearest": sum(_is_whole(one, None) for one, _ in with_any),
            "whole, surest": sum(_is_whole(one, sure) for one, sure in with_any),
        })  # fmt: skip
    return table


def reliability(answers: Sequence[Answer]) -> list[dict[str, Any]]:
    """A row for each range of the confidence: how many segments of each set there are, how sure they are and how often whole."""
    table, groups = [], {_IMAGES: True, "others": False}
    for low, high in itertools.pairwise(_BINS):
        row: dict[str, Any] = {"confidence": f"{low:g} to {high:g}"}
        for name, of_images in groups.items():
            some = [(one, sure) for one, sure, _ in answers if (one.set == _IMAGES) == of_images]
            y, p = (np.concatenate([np.empty(0), *parts]) for parts in ([one.whole[one.scored] for one, _ in some], [sure[one.scored] for one, sure in some]))  # fmt: skip
            within = (p >= low) & (p < high)
            mean, share = (f"{float(v[within].mean()):.2f}" if within.any() else "" for v in (p, y))
            row |= {name: int(within.sum()), f"mean, {name}": mean, f"whole, {name}": share}
        table.append(row)
    return table


def write(scenes: Sequence[Segments], table: Sequence[dict[str, Any]]) -> None:
    """Write the weights, fitted to all scenes, with the figures of the sources left out."""
    weights = dict(zip((*objects.INPUTS, "constant"), fit(scenes).round(4).tolist(), strict=True))
    record = {
        "what": "log odds that a segment is one whole object: the sum of weights times inputs, and a constant",
        "made_by": "python -m benchmarks.clutter.confidence --write",
        "versions": {"numpy": np.__version__, "sklearn": sklearn.__version__},
        "learned_from": {name: sum(one.scored.sum() for one in scenes if one.set == name).item() for name in dict.fromkeys(one.set for one in scenes)},
        "left_out": [dict(row) for row in table],
        "weights": weights,
    }  # fmt: skip
    objects.WEIGHTS.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")


def main() -> None:
    """Print the tables; write the weights and the tables of confidence.md if asked."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--every", type=int, default=1, help="use every N-th scene of each set")
    parser.add_argument(
        "--write", action="store_true", help="write the weights of the package, and the tables of confidence.md"
    )
    add_data(parser)
    options = parser.parse_args()
    recorder = Recorder()
    scenes = [
        recorder.segments(name, scene)
        for name, folder in labelled_sets(None if options.data is None else Path(options.data)).items()
        for scene in list(load_scenes(folder))[:: options.every]
    ]
    answers = list(left_out(scenes))
    tables = rows(answers), reliability(answers)
    for table in tables:
        print_rows(table)
        print()
    if options.write:
        write(scenes, tables[0])
        texts = (markdown(list(table[0]), [list(row.values()) for row in table]) for table in tables)
        replace_marked(HERE / "confidence.md", "\n".join(texts).strip())


if __name__ == "__main__":
    main()
