# SPDX-License-Identifier: Apache-2.0
"""Area `perception`: masks and contacts against the time of segmentation and GeoGrasp on a cloud.

Scenes of three objects are generated, and the masks of a segmentation are compared with the true ones. The grasps are
grasps of method `original`, whose settings these are, on the objects as the shipped segmentation finds them; the best one
of each is scored by its own score at full resolution. How many grasps of method `completed` hold in how much time is
measured in physics, by `benchmarks/grasp_physics`.
"""

import hashlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import cycle
from pathlib import Path
from typing import Final

import numpy as np

from foretouch.config import setting
from foretouch.grasp.original_score import original_score
from foretouch.pipeline import Pipeline, PipelineConfig
from foretouch.types import Cloud, Int32
from foretouch.types.scene import Object
from foretouch_lab.experiments.framework.experiment import Row
from foretouch_lab.experiments.framework.tradeoff import Panel, Timed, TradeoffSettings, Variant, make_area
from foretouch_lab.experiments.shared.scores import interval_columns
from foretouch_lab.learning.evaluation.metrics import ScoreEstimate
from foretouch_lab.simulation.depth_scene import FIRST_OBJECT, random_scene

_NOISE_M: Final = 0.001  # standard deviation of the depth at 1 m
_TIMED: Final = 8  # clouds that are timed in turn
_STEPS: Final = {"iou": "segmentation", "score": "grasp"}  # by the skill: the step that is measured, and its settings


def _variants() -> Iterator[Variant]:
    """Iterate over the variants, each of which changes settings of one step alone."""
    yield Variant("segmentation as shipped", "shipped", {"skill": "iou", "changes": {}})
    yield Variant("GeoGrasp as shipped", "shipped", {"skill": "score", "changes": {}})
    others: tuple[tuple[str, str, Mapping[str, float]], ...] = (
        *(("iou", "grid", {"grid_rows": rows}) for rows in (60, 80, 240, 10_000)),  # the last one: every pixel
        *(("iou", "height", {"clusters.min_height_m": height}) for height in (0.002, 0.006)),
        ("iou", "gap", {"clusters.gap_m": 0.016}),
        *(("score", "points", {"max_points": count}) for count in (500, 1000, 3000, 0)),  # the last one: all
        ("score", "neighbours", {"neighbours": 20}),
        ("score", "normal radius", {"normal_radius_m": 0.015}),
        ("score", "slab", {"slab_half_width_m": 0.004}),
        ("score", "points x neighbours", {"max_points": 1000, "neighbours": 10}),
    )
    for skill, factor, changes in others:
        name = ", ".join(f"{key.rpartition('.')[2].replace('_', ' ')} {value:g}" for key, value in changes.items())
        yield Variant(name, factor, {"skill": skill, "changes": changes})


VARIANTS: Final = tuple(_variants())


@dataclass(frozen=True, kw_only=True)
class PerceptionSettings(TradeoffSettings):
    """Settings of the area."""

    scenes: int = setting(40, "Number of generated scenes of three objects", bounds=(2, 1000))


@dataclass(frozen=True, eq=False)
class Scenes:
    """(H, W, 3) clouds, each with its (H, W) true labels, of which `FIRST_OBJECT` and on are objects."""

    images: tuple[tuple[Cloud, Int32], ...]

    @property
    def sha256(self) -> str:
        """Hash of the clouds."""
        return hashlib.sha256(b"".join(cloud.xyz.tobytes() for cloud, _ in self.images)).hexdigest()

    @cached_property
    def targets(self) -> list[tuple[int, Object]]:
        """The objects that the shipped segmentation finds, with the number of their scene."""
        pipeline = _pipeline(VARIANTS[0])
        return [(k, target) for k, (cloud, _) in enumerate(self.images) for target in pipeline.segment(cloud).targets]


def _load(settings: PerceptionSettings, _path: Path) -> Scenes:
    """Render the scenes: boxes, cans or balls, 848x480, with depth noise and flying pixels."""
    rngs = [np.random.default_rng(seed) for seed in range(settings.scenes)]
    images = [random_scene(rng).render(rng, _NOISE_M, True) for rng in rngs]
    return Scenes(tuple((image.cloud(), image.labels) for image in images))


def _pipeline(variant: Variant) -> Pipeline:
    """Return the shipped pipeline with method `original`, all objects as targets, and the changed settings of one step."""
    changes = {f"{_STEPS[variant.values['skill']]}.{name}": value for name, value in variant.values["changes"].items()}
    return Pipeline(PipelineConfig().updated({"grasp.method": "original", "target.mode": "all", **changes}))


def overlaps(labels: Int32, truth: Int32) -> list[float]:
    """Return the intersection over union of each true object with the found one that covers it most.

    Args:
        labels: (H, W) labels of a segmentation, objects from 1 on.
        truth: (H, W) true labels, objects from `FIRST_OBJECT` on.
    """
    shares = []
    for label in range(FIRST_OBJECT, int(truth.max()) + 1):
        true = truth == label
        covering = labels == 1 + int(np.bincount(labels[true], minlength=2)[1:].argmax())
        shares.append(float((true & covering).sum() / (true | covering).sum()))
    return shares


def _scores(pipeline: Pipeline, data: Scenes) -> Iterator[tuple[int, float]]:
    """Iterate over scores of the best grasps at full resolution; objects without a grasp or a score are left out."""
    for number, target in data.targets:
        scorer, grasps = original_score(target.cloud, target.plane), pipeline.plan(target).grasps
        if grasps and scorer is not None and scorer.has_axis:
            score = scorer(np.stack([grasps[0].g1, grasps[0].g2]))[0]
            if np.isfinite(score):
                yield number, score


def _accuracy(skill: str, settings: PerceptionSettings, data: Scenes) -> Mapping[str, Row]:
    result = {}
    for variant in (variant for variant in VARIANTS if variant.values["skill"] == skill):
        pipeline = _pipeline(variant)
        if skill == "score":
            values = list(_scores(pipeline, data))
        else:
            labels = [pipeline.segment(cloud).labels for cloud, _ in data.images]
            pairs = [overlaps(mine, truth) for mine, (_, truth) in zip(labels, data.images, strict=True)]
            values = [(number, iou) for number, own in enumerate(pairs) for iou in own]
        result[variant.name] = interval_columns(skill, _mean(values, settings.bootstrap.draws))
    return result


def _mean(values: Sequence[tuple[int, float]], draws: int) -> ScoreEstimate:
    """Return the mean over objects, each with the number of its scene, and its 95 % interval by drawing scenes."""
    numbers, scene = np.unique([number for number, _ in values], return_inverse=True)
    sums, counts = np.bincount(scene, [value for _, value in values]), np.bincount(scene)
    drawn = np.random.default_rng(0).integers(0, len(numbers), (draws, len(numbers)))
    low, high = np.percentile(sums[drawn].sum(axis=1) / counts[drawn].sum(axis=1), (2.5, 97.5))
    return ScoreEstimate(float(sums.sum() / counts.sum()), float(low), float(high))


def _timed(variant: Variant, _settings: PerceptionSettings, data: Scenes) -> Timed:
    """Return what segments generated scenes, or plans grasps on their objects, one after the other."""
    pipeline = _pipeline(variant)
    if variant.values["skill"] == "iou":
        calls: list[Callable[[], object]] = [partial(pipeline.segment, cloud) for cloud, _ in data.images[:_TIMED]]
    else:
        ordered = sorted((target for _, target in data.targets), key=lambda target: target.cloud.size)
        chosen = np.linspace(0, len(ordered) - 1, min(_TIMED, len(ordered))).astype(int)  # of all sizes, evenly spread
        calls = [partial(pipeline.plan, ordered[k]) for k in chosen]
    turn = cycle(calls)
    return lambda _: next(turn)(), 1.0


EXPERIMENT = make_area(
    _accuracy,
    name="tradeoff_perception",
    question="How well can objects and grasps be found in a few milliseconds?",
    module=__name__,
    settings=PerceptionSettings,
    presets={"small": {"scenes": 8, "timing_s": 25.0}, "full": {"timing_s": 150.0}},
    prepare=lambda _settings, _source, out: out,  # scenes are generated
    load=_load,
    variants=VARIANTS,
    timed=_timed,
    panels=(
        Panel("iou", 1, "Segmentation, 848x480: masks of the objects", "mean IoU of the objects, 95 % interval"),
        Panel("score", 1, "GeoGrasp: score of the best grasp at full resolution", "mean original score, 95 % interval"),
    ),
)
