# SPDX-License-Identifier: Apache-2.0
"""Area `perception`: masks and contacts against the time of segmentation and GeoGrasp on a cloud.

Generated scenes of three objects are taken through the pipeline with the changed setting and with the shipped ones. The
grasps are those of method `original`, whose settings these are, and best grasps of both are scored by its own score at full
resolution on the object as the shipped segmentation sees it, so that a grasp that moved can be distinguished from a
grasp that is worse. How many grasps of method `completed` hold in how much time is measured in physics, by
`benchmarks/grasp_physics`. One variant adds noise to the points of the objects, with the shipped settings: it
shows what a camera's next image would do as well.
"""

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import cycle
from pathlib import Path
from typing import Any, Final

import numpy as np

from foretouch.config import setting
from foretouch.grasp.original_score import OriginalScore, original_score
from foretouch.pipeline import FoundObject, Pipeline, PipelineConfig
from foretouch.types import Bool, Cloud, Float64, Int32
from foretouch_lab.experiments.framework.experiment import Cell, Row
from foretouch_lab.experiments.framework.tradeoff import Area, Panel, Timed, TradeoffSettings, Variant, variant_cells
from foretouch_lab.experiments.shared.scores import interval_columns
from foretouch_lab.experiments.shared.tables import grouped
from foretouch_lab.learning.evaluation.metrics import ScoreEstimate
from foretouch_lab.simulation.depth_scene import FIRST_OBJECT, random_scene

SEGMENTATION: Final = "segmentation"
GRASP: Final = "GeoGrasp"

_NOISE_M: Final = 0.001  # standard deviation of the depth at 1 m
_MOVED_MM: Final = 5.0  # a best grasp has moved if a contact is farther from before
_DRAWS: Final = 1000  # of the bootstrap
_TIMED: Final = 8  # clouds that are timed in turn

# Step, factor, and the changed settings of the step.
_VARIANTS: Final[tuple[tuple[str, str, Mapping[str, Any]], ...]] = (
    (SEGMENTATION, "shipped", {}),
    (GRASP, "shipped", {}),
    (SEGMENTATION, "grid", {"grid_rows": 10_000}),  # every pixel
    *((SEGMENTATION, "grid", {"grid_rows": rows}) for rows in (60, 80, 240)),
    *((SEGMENTATION, "height", {"clusters.min_height_m": height}) for height in (0.002, 0.006)),
    (SEGMENTATION, "gap", {"clusters.gap_m": 0.016}),
    (GRASP, "points", {"max_points": 0}),  # all
    *((GRASP, "points", {"max_points": count}) for count in (500, 1000, 3000)),
    (GRASP, "neighbours", {"neighbours": 20}),
    (GRASP, "normal radius", {"normal_radius_m": 0.015}),
    (GRASP, "slab", {"slab_half_width_m": 0.004}),
    (GRASP, "points x neighbours", {"max_points": 1000, "neighbours": 10}),
)


@dataclass(frozen=True, kw_only=True)
class PerceptionSettings(TradeoffSettings):
    """Settings of the area."""

    scenes: int = setting(40, "Number of generated scenes of three objects", bounds=(2, 1000))


Scene = tuple[Cloud, Int32]  # (H, W, 3) cloud with its (H, W) true labels, of which 2 and on are objects


@dataclass(frozen=True, eq=False)
class PerceptionData:
    """What settings are measured on."""

    scenes: tuple[Scene, ...]
    sha256: str


def _load(settings: PerceptionSettings, _path: Path) -> PerceptionData:
    """Render the scenes: boxes, cans or balls, 848x480, with depth noise and flying pixels."""
    rngs = [np.random.default_rng(seed) for seed in range(settings.scenes)]
    images = [random_scene(rng).render(rng, _NOISE_M, True) for rng in rngs]
    scenes = tuple((image.cloud(), image.labels) for image in images)
    content = hashlib.sha256(b"".join(np.ascontiguousarray(cloud.xyz).tobytes() for cloud, _ in scenes))
    return PerceptionData(scenes, content.hexdigest())


def _variants(_settings: PerceptionSettings) -> Iterator[Variant]:
    """Each changes settings of one step alone, or no setting but the points by noise."""
    for step, factor, changes in _VARIANTS:
        name = ", ".join(f"{key.rpartition('.')[2].replace('_', ' ')} {value:g}" for key, value in changes.items())
        yield Variant(name or f"{step} as shipped", factor, {"step": step, "changes": dict(changes)})
    yield Variant("points moved by 0.1 mm", "noise", {"step": GRASP, "changes": {}, "jitter_mm": 0.1})


@dataclass(frozen=True, eq=False)
class _Grasped:
    """An object that was looked for in a scene, with its best grasp."""

    iou: float  # of its mask with the true one
    found: FoundObject | None = None  # None if it was not found
    contacts: Float64 | None = None  # (2, 3) float64 [m]; None without a grasp


def overlaps(labels: Int32, truth: Int32, objects: Sequence[int]) -> list[float]:
    """Intersection over union of each true object with the found one that covers it most."""
    pairs = [(truth == label, labels == _covering(labels, truth == label)) for label in objects]
    return [float((true & found).sum() / (true | found).sum()) for true, found in pairs]


def _covering(labels: Int32, true: Bool) -> int:
    return 1 + int(np.bincount(labels[true], minlength=2)[1:].argmax())


def _pipeline(values: Mapping[str, Any]) -> Pipeline:
    """The shipped pipeline with method `original`, and with the changed settings of one step."""
    group = "segmentation" if values["step"] == SEGMENTATION else "grasp"
    changes = {f"{group}.{name}": value for name, value in values["changes"].items()}
    return Pipeline(PipelineConfig().updated({"grasp.method": "original", **changes}))


def _grasp_objects(pipeline: Pipeline, scene: Scene, jitter_mm: float = 0.0) -> tuple[list[_Grasped], int]:
    """The true objects of a scene as the pipeline finds and grasps them, and the number of objects it found."""
    cloud, truth = scene
    found, objects = pipeline.segment(cloud).segmentation, _object_labels(truth)
    result = []
    for label, iou in zip(objects, overlaps(found.labels, truth, objects), strict=True):
        number = _covering(found.labels, truth == label)
        segments = [one for one in found.objects if one.id == number]
        if not segments or found.plane is None or iou == 0.0:
            result.append(_Grasped(0.0))
            continue
        seen = segments[0].cloud
        if jitter_mm:
            noise = np.random.default_rng(0).normal(0.0, 1e-3 * jitter_mm, seen.xyz.shape)
            seen = Cloud((seen.xyz + noise).astype(np.float32))
        target = FoundObject(str(number), seen, found.plane, segments[0].pixels, (truth.shape[0], truth.shape[1]))
        grasps = pipeline.plan(target).grasps
        result.append(_Grasped(iou, target, np.stack([grasps[0].g1, grasps[0].g2]) if grasps else None))
    return result, len(found.objects)


def _object_labels(truth: Int32) -> range:
    return range(FIRST_OBJECT, int(truth.max()) + 1)


@lru_cache(maxsize=1)
def _shipped(data: PerceptionData) -> list[list[_Grasped]]:
    pipeline = _pipeline({"step": GRASP, "changes": {}})
    return [_grasp_objects(pipeline, one)[0] for one in data.scenes]


@lru_cache(maxsize=4096)
def _scorer(found: FoundObject) -> OriginalScore | None:
    scorer = original_score(found.cloud, found.plane)
    return scorer if scorer is not None and scorer.has_axis else None


def _run(cell: Cell, _settings: PerceptionSettings, data: PerceptionData) -> list[Row]:
    """A row for each object."""
    pipeline, rows = _pipeline(cell.values), []
    for number, (scene, shipped) in enumerate(zip(data.scenes, _shipped(data), strict=True)):
        changed, count = _grasp_objects(pipeline, scene, cell.values.get("jitter_mm", 0.0))
        wrong = count != len(_object_labels(scene[1]))
        pairs = zip(changed, shipped, strict=True)
        rows += [{"scene": number, "wrong": wrong, **_compared(one, other)} for one, other in pairs]
    return rows


def _compared(one: _Grasped, shipped: _Grasped) -> Row:
    """An object against the same with the shipped settings; what cannot be compared is None."""
    row: Row = {"iou": one.iou, "grasped": one.contacts is not None, "score": None, "score_change": None, "moved": None}
    if one.contacts is None or shipped.contacts is None or shipped.found is None:
        return row
    row["moved"] = bool(1e3 * np.linalg.norm(one.contacts - shipped.contacts, axis=1).max() > _MOVED_MM)
    if (scorer := _scorer(shipped.found)) is not None:
        score, before = scorer(one.contacts)[0], scorer(shipped.contacts)[0]
        if np.isfinite([score, before]).all():
            row |= {"score": score, "score_change": score - before}
    return row


def _tabulate(_settings: PerceptionSettings, rows: Sequence[Row]) -> list[Row]:
    """A row for each variant: masks of a segmentation, scores of a GeoGrasp, and what both do to grasps."""
    result = []
    for name, own in grouped(rows, "variant"):
        masks = own[0]["step"] == SEGMENTATION
        moved = [one["moved"] for one in own if one["moved"] is not None]
        result.append({
            "variant": name,
            **_interval("iou", own if masks else []),
            "wrong_scenes": len({one["scene"] for one in own if one["wrong"]}) if masks else None,
            **_interval("score", [] if masks else own),
            "objects": len(own),
            "no_grasp": sum(not one["grasped"] for one in own),
            "moved": float(np.mean(moved)) if moved else None,
            **_interval("score_change", own),
        })  # fmt: skip
    return result


def _interval(key: str, rows: Sequence[Row]) -> Row:
    """Mean over objects, and its 95 % interval by drawing scenes."""
    known = [row for row in rows if row[key] is not None]
    if not known:
        return interval_columns(key, None)
    numbers, scene = np.unique([row["scene"] for row in known], return_inverse=True)
    sums, counts = np.bincount(scene, [row[key] for row in known]), np.bincount(scene)
    drawn = np.random.default_rng(0).integers(0, len(numbers), (_DRAWS, len(numbers)))
    low, high = np.percentile(sums[drawn].sum(axis=1) / counts[drawn].sum(axis=1), (2.5, 97.5))
    return interval_columns(key, ScoreEstimate(float(sums.sum() / counts.sum()), float(low), float(high)))


def _timed(variant: Variant, _settings: PerceptionSettings, data: PerceptionData) -> Timed:
    """See `Area.timed`: segments generated scenes, or plans grasps on their objects, one after the other."""
    pipeline = _pipeline(variant.values)
    if variant.values["step"] == SEGMENTATION:
        clouds = cycle([cloud for cloud, _ in data.scenes[:_TIMED]])
        return lambda _: pipeline.segment(next(clouds)), 1.0
    found = [one.found for scene in _shipped(data)[:_TIMED] for one in scene if one.found is not None]
    ordered = sorted(found, key=lambda one: one.cloud.size)  # objects of all sizes, evenly spread
    targets = cycle([ordered[k] for k in np.linspace(0, len(ordered) - 1, min(_TIMED, len(ordered))).astype(int)])
    return lambda _: pipeline.plan(next(targets)), 1.0


EXPERIMENT = Area(
    name="tradeoff_perception",
    question="How well can objects and grasps be found in a few milliseconds?",
    module=__name__,
    settings=PerceptionSettings,
    presets={"small": {"scenes": 8, "timing_s": 25.0}, "full": {"timing_s": 150.0}},
    prepare=lambda _settings, _source, out: out,  # scenes are generated
    load=_load,
    cells=variant_cells(_variants),
    run=_run,
    tabulate=_tabulate,
    variants=_variants,
    timed=_timed,
    skills={"iou": "mean IoU of the objects, 95 % interval", "score": "mean original score, 95 % interval"},
    panels=(
        Panel("iou", 1, "Segmentation, 848x480: masks of the objects"),
        Panel("score", 1, "GeoGrasp: score of the best grasp at full resolution"),
    ),
)
