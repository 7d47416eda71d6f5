# SPDX-License-Identifier: Apache-2.0
"""What a setting of segmentation or GeoGrasp does to masks, contacts and predicted touch.

Each object of a scene is taken through the whole pipeline with the changed setting and with the shipped ones. Best
grasps of both are scored by the same function, the original's score at full resolution on the object as the shipped
segmentation sees it, so that a grasp that moved can be distinguished from a grasp that is worse. Variants that add noise to the
points of the objects, with the shipped settings, show what a camera's next image would do as well.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from foretouch.experiments.framework.experiment import Cell, Row
from foretouch.grasp.original_score import OriginalScore
from foretouch.pipeline import FoundObject, Pipeline, PipelineConfig
from foretouch.tradeoff.area import Answer, Timed, Variant
from foretouch.tradeoff.areas.perception.data import LabelledScene, PerceptionData, PerceptionSettings
from foretouch.tradeoff.areas.perception.variants import SEGMENTATION, list_variants
from foretouch.types import ASSUMED_TABLE, Cloud, Float64

EQUAL_SCORE: Final = 0.1
"""Scores that differ less belong to equal grasps; they range from 2.5, both rankings at their minimum, to 10."""

_DRAWS: Final = 1000  # of the bootstrap
_TIMED: Final = 8  # clouds that are timed in turn


@dataclass(frozen=True, eq=False)
class GraspedObject:
    """An object that was found in a scene, with its best grasp and the touch that is predicted for it."""

    iou: float  # of its mask with the true one; NaN of a real object
    found: FoundObject | None  # None if it was not found
    contacts: Float64 | None = None  # (2, 3) float64 [m]; None without a grasp
    touch: Float64 | None = None  # (50,) [counts]
    half: Float64 | None = None  # (50,) half widths of the intervals [counts]
    error_mm: float = float("nan")  # mean distance of both contacts from the true surface


def overlaps(labels: npt.NDArray[np.int32], truth: npt.NDArray[np.int32], objects: Sequence[int]) -> list[float]:
    """Intersection over union of each true object with the found one that covers it most."""
    result = []
    for label in objects:
        true = truth == label
        found = labels == _covering(labels, true)
        result.append(float((true & found).sum() / (true | found).sum()))
    return result


def _covering(labels: npt.NDArray[np.int32], true: npt.NDArray[np.bool_]) -> int:
    return 1 + int(np.bincount(labels[true], minlength=2)[1:].argmax())


def pipeline_of(changes: Mapping[str, Any], step: str) -> Pipeline:
    """The shipped pipeline with changed settings of one step."""
    group = "segmentation" if step == SEGMENTATION else "grasp"
    return Pipeline(PipelineConfig().updated({f"{group}.{name}": value for name, value in changes.items()}))


def grasp_objects(pipeline: Pipeline, scene: LabelledScene, jitter_mm: float = 0.0) -> tuple[list[GraspedObject], int]:
    """The true objects of a scene as the pipeline finds and grasps them, and the number of objects it found."""
    found = pipeline.segment(scene.cloud).segmentation
    shape = (scene.cloud.xyz.shape[0], scene.cloud.xyz.shape[1])
    result = []
    for label, iou in zip(scene.object_labels, overlaps(found.labels, scene.labels, scene.object_labels), strict=True):
        number = _covering(found.labels, scene.labels == label)
        segments = [one for one in found.objects if one.id == number]
        if not segments or found.plane is None or iou == 0.0:
            result.append(GraspedObject(0.0, None))
            continue
        seen = _jittered(segments[0].cloud, jitter_mm)
        target = FoundObject(str(number), seen, found.plane, segments[0].pixels, shape)
        result.append(_grasped(pipeline, target, iou, scene, label - scene.object_labels.start))
    return result, len(found.objects)


def grasp_real(pipeline: Pipeline, cloud: Cloud, jitter_mm: float = 0.0) -> GraspedObject:
    """A real object on its own, with the table that is assumed below it."""
    return _grasped(pipeline, FoundObject("1", _jittered(cloud, jitter_mm), ASSUMED_TABLE), float("nan"), None, 0)


def _jittered(cloud: Cloud, jitter_mm: float) -> Cloud:
    if not jitter_mm:
        return cloud
    noise = np.random.default_rng(0).normal(0.0, 1e-3 * jitter_mm, cloud.xyz.shape)
    return Cloud((cloud.xyz + noise).astype(np.float32))


def _grasped(
    pipeline: Pipeline, target: FoundObject, iou: float, scene: LabelledScene | None, index: int
) -> GraspedObject:
    grasps = pipeline.plan(target).grasps
    if not grasps:
        return GraspedObject(iou, target)
    contacts = np.stack([grasps[0].g1, grasps[0].g2])
    (predicted,) = pipeline.predict(target, grasps[:1])
    error = float("nan")
    if scene is not None and scene.view is not None:
        world = contacts @ scene.view.R_world_camera.T + scene.view.eye
        error = 1e3 * float(scene.solids[index].surface_distance(world).mean())
    if predicted.value is None or predicted.lower is None or predicted.upper is None:
        return GraspedObject(iou, target, contacts, error_mm=error)
    half = (predicted.upper.vector() - predicted.lower.vector()) / 2.0
    return GraspedObject(iou, target, contacts, predicted.value.vector(), half, error)


@lru_cache(maxsize=1)
def _shipped(data: PerceptionData) -> tuple[list[list[GraspedObject]], list[GraspedObject]]:
    pipeline = Pipeline()
    return [grasp_objects(pipeline, scene)[0] for scene in data.scenes], [
        grasp_real(pipeline, one) for one in data.real
    ]


@lru_cache(maxsize=4096)
def _scorer(found: FoundObject) -> OriginalScore | None:
    scorer = OriginalScore.of(found.cloud, found.plane)
    return scorer if scorer is not None and scorer.has_axis else None


def cells(settings: PerceptionSettings, data: PerceptionData) -> list[Cell]:
    """A cell for each variant."""
    del data
    return [
        Cell(f"{number:03}", {"variant": one.name, **one.values})
        for number, one in enumerate(list_variants(settings.detail))
    ]


def run(cell: Cell, settings: PerceptionSettings, data: PerceptionData) -> list[Row]:
    """A row for each object."""
    pipeline = pipeline_of(cell.values["changes"], cell.values["step"])
    jitter_mm = cell.values.get("jitter_mm", 0.0)
    before, real_before = _shipped(data)
    rows = []
    for number, (scene, shipped) in enumerate(zip(data.scenes, before, strict=True)):
        changed, count = grasp_objects(pipeline, scene, jitter_mm)
        wrong = count != len(scene.object_labels)
        for one, other in zip(changed, shipped, strict=True):
            rows.append({"scene": number, "wrong": wrong, "iou": one.iou, **_compared(one, other, settings)})
    if cell.values["step"] != SEGMENTATION:
        for number, (cloud, other) in enumerate(zip(data.real, real_before, strict=True), len(data.scenes)):
            one = grasp_real(pipeline, cloud, jitter_mm)
            rows.append({"scene": number, "wrong": False, "iou": None, **_compared(one, other, settings)})
    return rows


def _compared(one: GraspedObject, shipped: GraspedObject, settings: PerceptionSettings) -> Row:
    """An object against the same with the shipped settings; what cannot be compared is None."""
    row: Row = dict.fromkeys(("score", "score_change", "touch_counts", "touch_half"))
    row |= {"grasped": one.contacts is not None, "moved": None}
    row["error_mm"] = None if np.isnan(one.error_mm) else one.error_mm
    if one.contacts is None or shipped.contacts is None or shipped.found is None:
        return row
    row["moved"] = bool(1e3 * np.linalg.norm(one.contacts - shipped.contacts, axis=1).max() > settings.moved_mm)
    scorer = _scorer(shipped.found)
    if scorer is not None:
        score, before = scorer(one.contacts)[0], scorer(shipped.contacts)[0]
        if np.isfinite([score, before]).all():
            row |= {"score": score, "score_change": score - before}
    if one.touch is not None and shipped.touch is not None and shipped.half is not None:
        change = np.abs(one.touch - shipped.touch)
        row |= {"touch_counts": float(change.mean()), "touch_half": float((change / shipped.half).mean())}
    return row


def tabulate(settings: PerceptionSettings, rows: Sequence[Row]) -> list[Row]:
    """A row for each variant: masks of a segmentation, scores of a GeoGrasp, and what both do to grasps and touch."""
    del settings
    result = []
    for name in dict.fromkeys(row["variant"] for row in rows):
        own = [row for row in rows if row["variant"] == name]
        masks = own[0]["step"] == SEGMENTATION
        row: Row = {"variant": name, **_interval("iou", own if masks else [])}
        row["iou_least"] = min((one["iou"] for one in own), default=None) if masks else None
        row["wrong_scenes"] = len({one["scene"] for one in own if one["wrong"]}) if masks else None
        row |= _interval("score", [] if masks else own)
        row |= {"objects": len(own), "no_grasp": sum(not one["grasped"] for one in own)}
        row["contact_mm"] = _mean(own, "error_mm")
        row |= _moves(own)
        row |= _interval("score_change", own)
        real = [one for one in own if one["iou"] is None]
        for key in ("touch_counts", "touch_half"):
            row |= {key: _mean(own, key), f"{key}_real": _mean(real, key)}
        result.append({key: round(value, 5) if isinstance(value, float) else value for key, value in row.items()})
    return result


def _moves(rows: Sequence[Row]) -> Row:
    """Share of best grasps that moved, and of those that have a score, whether it is equal, better or worse."""
    known = [row for row in rows if row["moved"] is not None]
    moved = [row["score_change"] for row in known if row["moved"] and row["score_change"] is not None]
    changes = np.array(moved)
    shares: dict[str, Any] = {"moved": sum(row["moved"] for row in known) / max(len(known), 1)}
    tests = {"equal": np.abs(changes) <= EQUAL_SCORE, "better": changes > EQUAL_SCORE, "worse": changes < -EQUAL_SCORE}
    return shares | {f"moved_{name}": float(test.mean()) if len(moved) else None for name, test in tests.items()}


def _values(rows: Sequence[Row], key: str) -> Float64:
    return np.array([row[key] for row in rows if row[key] is not None], np.float64)


def _mean(rows: Sequence[Row], key: str) -> float | None:
    values = _values(rows, key)
    return float(values.mean()) if len(values) else None


def _interval(key: str, rows: Sequence[Row]) -> Row:
    """Mean over objects, and its 95 % interval by drawing scenes."""
    known = [row for row in rows if row[key] is not None]
    if not known:
        return {key: None, f"{key}_low": None, f"{key}_high": None}
    numbers, scene = np.unique([row["scene"] for row in known], return_inverse=True)
    sums = np.bincount(scene, _values(known, key))
    counts = np.bincount(scene)
    drawn = np.random.default_rng(0).integers(0, len(numbers), (_DRAWS, len(numbers)))
    low, high = np.percentile(sums[drawn].sum(axis=1) / counts[drawn].sum(axis=1), (2.5, 97.5))
    return {key: float(sums.sum() / counts.sum()), f"{key}_low": float(low), f"{key}_high": float(high)}


def timed(variant: Variant, settings: PerceptionSettings, data: PerceptionData) -> Timed:
    """See `Area.timed`: segments scenes, or plans grasps on objects, one after the other.

    Answers are the centroid of the nearest object, (3,), or the contacts of the best grasp, (6,) [m].
    """
    del settings
    step = variant.values["step"]
    pipeline = pipeline_of(variant.values["changes"], step)
    clouds = _in_turn([scene.cloud for scene in data.scenes if scene.view is not None][:_TIMED])
    targets = _in_turn(_timed_targets(data))

    def segment(request: int) -> Answer:
        del request
        return np.asarray(pipeline.segment(next(clouds)).segmentation.objects[0].centroid)

    def plan(request: int) -> Answer:
        del request
        grasps = pipeline.plan(next(targets)).grasps
        return np.concatenate([grasps[0].g1, grasps[0].g2]) if grasps else np.zeros(6)

    return Timed(segment if step == SEGMENTATION else plan)


def _in_turn(items: Sequence[Any]) -> Iterator[Any]:
    while True:
        yield from items


@lru_cache(maxsize=1)
def _timed_targets(data: PerceptionData) -> list[FoundObject]:
    """Objects of all sizes: of the generated scenes, by number of points, evenly spread."""
    found = [one for scene in data.scenes[:_TIMED] for one in grasp_objects(Pipeline(), scene)[0]]
    targets = sorted((one.found for one in found if one.found is not None), key=lambda one: one.cloud.size)
    return [targets[k] for k in np.linspace(0, len(targets) - 1, min(_TIMED, len(targets))).astype(int)]
