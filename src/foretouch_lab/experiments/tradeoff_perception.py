# SPDX-License-Identifier: Apache-2.0
"""Area `perception`: masks, contacts and predicted touch against the time of segmentation and GeoGrasp on a cloud.

Each object of a scene is taken through the whole pipeline with the changed setting and with the shipped ones. The grasps
are those of method `original`, whose settings these are, and best grasps of both are scored by its own score at full
resolution on the object as the shipped segmentation sees it, so that a grasp that moved can be distinguished from a
grasp that is worse. How many grasps of method `completed` hold in how much time is measured in physics, by
`benchmarks/grasp_physics`. Variants that add noise to the points of the objects, with the shipped settings, show what a camera's next image would do as well.
"""

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import cycle
from pathlib import Path
from typing import Any, Final

import numpy as np

from foretouch.cloud.io.files import read_cloud
from foretouch.config import setting
from foretouch.errors import ConfigError
from foretouch.grasp.original_score import OriginalScore, original_score
from foretouch.pipeline import FoundObject, Pipeline, PipelineConfig
from foretouch.types import ASSUMED_TABLE, Bool, Cloud, Float64, Int32
from foretouch_lab.experiments.framework.experiment import Cell, Row
from foretouch_lab.experiments.framework.tradeoff import Area, Panel, Timed, TradeoffSettings, Variant, variant_cells
from foretouch_lab.experiments.shared.scores import interval_columns
from foretouch_lab.experiments.shared.tables import grouped
from foretouch_lab.learning.evaluation.metrics import ScoreEstimate
from foretouch_lab.simulation.depth_scene import FIRST_OBJECT, random_scene

SEGMENTATION: Final = "segmentation"
GRASP: Final = "GeoGrasp"

_REFERENCES: Final = ((SEGMENTATION, "every pixel", {"grid_rows": 10_000}), (GRASP, "all points", {"max_points": 0}))
_NOISE_M: Final = 0.001  # standard deviation of the depth at 1 m
_SHARED: Final = ("oblique_848x480.npz", "oblique_1280x720.npz")
_REAL: Final = "vision2tactile/*/*/cloud-object.pcd"
_MOVED_MM: Final = 5.0  # a best grasp has moved if a contact is farther from before
_DRAWS: Final = 1000  # of the bootstrap
_TIMED: Final = 8  # clouds that are timed in turn

_UNCHANGED: Final[Mapping[str, Any]] = {"step": GRASP, "changes": {}}

_Values = tuple[Any, ...]
# Step, name of the factor, setting, values of `all`, and those of `few`.
_FACTORS: Final[tuple[tuple[str, str, str, _Values, _Values], ...]] = (
    (SEGMENTATION, "grid", "grid_rows", (60, 80, 160, 240), (60, 80, 240)),
    (SEGMENTATION, "crop", "crop.max_range_m", (1.5, 4.0), ()),
    (SEGMENTATION, "plane threshold", "plane.threshold_m", (0.005, 0.02), ()),
    (SEGMENTATION, "plane samples", "plane.max_trials", (64, 4096), ()),
    (SEGMENTATION, "height", "clusters.min_height_m", (0.002, 0.006, 0.008), (0.006,)),
    (SEGMENTATION, "noise", "clusters.noise_factor", (0.0, 1.5, 4.0), ()),
    (SEGMENTATION, "gap", "clusters.gap_m", (0.004, 0.016), (0.016,)),
    (SEGMENTATION, "slope", "clusters.max_slope", (10.0, 40.0), ()),
    (SEGMENTATION, "flying", "clusters.flying_slope", (2.0, 8.0), ()),
    (GRASP, "points", "max_points", (500, 1000, 1500, 2000, 3000, 5000), (1000, 3000)),
    (GRASP, "neighbours", "neighbours", (10, 20, 30, 80), (20,)),
    (GRASP, "normal radius", "normal_radius_m", (0.008, 0.01, 0.015, 0.02, 0.04), (0.015,)),
    (GRASP, "outliers", "outlier_deviations", (0.5, 2.0, 3.0), ()),
    (GRASP, "slab", "slab_half_width_m", (0.004, 0.01, 0.014), ()),
)

_PAIRS: Final[tuple[tuple[str, str, Mapping[str, Any]], ...]] = (
    (SEGMENTATION, "grid x height", {"grid_rows": 80, "clusters.min_height_m": 0.002}),
    (SEGMENTATION, "grid x gap", {"grid_rows": 80, "clusters.gap_m": 0.004}),
    (SEGMENTATION, "grid x gap", {"grid_rows": 60, "clusters.gap_m": 0.004}),
    (SEGMENTATION, "grid x flying", {"grid_rows": 80, "clusters.flying_slope": 2.0}),
    (SEGMENTATION, "grid x samples", {"grid_rows": 80, "plane.max_trials": 64}),
    (GRASP, "points x neighbours", {"max_points": 3000, "neighbours": 20}),
    (GRASP, "points x neighbours", {"max_points": 1500, "neighbours": 20}),
    (GRASP, "points x neighbours", {"max_points": 1000, "neighbours": 10}),
    (GRASP, "points x radius", {"max_points": 3000, "normal_radius_m": 0.015}),
    (GRASP, "points x radius", {"max_points": 3000, "normal_radius_m": 0.02}),
    (GRASP, "points x radius", {"max_points": 1500, "normal_radius_m": 0.02}),
    (GRASP, "neighbours x radius", {"neighbours": 20, "normal_radius_m": 0.015}),
    (GRASP, "neighbours x radius", {"neighbours": 20, "normal_radius_m": 0.02}),
)


@dataclass(frozen=True, kw_only=True)
class PerceptionSettings(TradeoffSettings):
    """Settings of the area."""

    scenes: int = setting(40, "Number of generated scenes of three objects", bounds=(2, 1000))
    real: int = setting(60, "Number of real objects, if recordings are given", bounds=(0, 1000))


@dataclass(frozen=True, eq=False)
class PerceptionData:
    """What settings are measured on."""

    scenes: tuple[
        tuple[Cloud, Int32], ...
    ]  # (H, W, 3) clouds with their (H, W) true labels, of which 2 and on are objects
    real: tuple[Cloud, ...]  # an object each
    sha256: str


def _scene(seed: int) -> tuple[Cloud, Int32]:
    """Three boxes, cans or balls, 848x480, with depth noise and flying pixels."""
    rng = np.random.default_rng(seed)
    image = random_scene(rng).render(rng, _NOISE_M, True)
    return image.cloud(), image.labels


def _prepare(_settings: PerceptionSettings, source: Path | None, _out: Path) -> Path:
    """The folder of recordings if there is one; scenes are generated."""
    if source is not None and not source.is_dir():
        raise ConfigError(f"--data: {source}: is not a folder of recordings")
    return source or Path() / "no recordings"


def _load(settings: PerceptionSettings, path: Path) -> PerceptionData:
    """Render the scenes, and read what the folder holds."""
    scenes = [_scene(seed) for seed in range(settings.scenes)]
    for name in _SHARED:
        if (path / "scenes" / name).is_file():
            with np.load(path / "scenes" / name) as shared:
                scenes.append((Cloud(shared["xyz"]), shared["labels"].astype(np.int32)))
    found = sorted(path.glob(_REAL))
    chosen = np.linspace(0, len(found) - 1, min(settings.real, len(found))).astype(int)
    real = tuple(Cloud(read_cloud(found[k]).xyz.reshape(-1, 3)) for k in chosen)
    content = hashlib.sha256()
    for cloud in (*(cloud for cloud, _ in scenes), *real):
        content.update(np.ascontiguousarray(cloud.xyz).tobytes())
    return PerceptionData(tuple(scenes), real, content.hexdigest())


def _variants(settings: PerceptionSettings) -> Iterator[Variant]:
    """Each changes settings of one step alone, or no setting but the points by noise."""
    every = settings.detail == "all"
    yield _variant(SEGMENTATION, "shipped", {})
    yield (shipped := _variant(GRASP, "shipped", {}))
    for step, name, reference in _REFERENCES:
        yield _variant(step, "reference", reference)._replace(name=name)
    for mm in (0.01, 0.1, 0.5) if every else (0.1,):
        yield Variant(f"points moved by {mm:g} mm", "noise", {**shipped.values, "jitter_mm": mm})
    for step, factor, name, values, few in _FACTORS:
        for value in values if every else few:
            yield _variant(step, factor, {name: value})
    for step, factor, changes in _PAIRS if every else ():
        yield _variant(step, factor, changes)


def _variant(step: str, factor: str, changes: Mapping[str, Any]) -> Variant:
    name = ", ".join(_text(key, value) for key, value in changes.items()) or f"{step} as shipped"
    return Variant(name, factor, {"step": step, "changes": dict(changes)})


def _text(key: str, value: Any) -> str:
    name = key.rpartition(".")[2]
    if name.endswith("_m"):
        return f"{name.removesuffix('_m').replace('_', ' ')} {1e3 * value:g} mm"
    return f"{name.replace('_', ' ')} {value:g}"


@dataclass(frozen=True, eq=False)
class GraspedObject:
    """An object that was found in a scene, with its best grasp and the touch that is predicted for it."""

    iou: float | None  # of its mask with the true one; None of a real object
    found: FoundObject | None  # None if it was not found
    contacts: Float64 | None = None  # (2, 3) float64 [m]; None without a grasp
    touch: Float64 | None = None  # (50,) [counts]
    half: Float64 | None = None  # (50,) half widths of the intervals [counts]


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


def _grasp_objects(
    pipeline: Pipeline, scene: tuple[Cloud, Int32], jitter_mm: float = 0.0
) -> tuple[list[GraspedObject], int]:
    """The true objects of a scene as the pipeline finds and grasps them, and the number of objects it found."""
    cloud, truth = scene
    found = pipeline.segment(cloud).segmentation
    objects = _object_labels(truth)
    result = []
    for label, iou in zip(objects, overlaps(found.labels, truth, objects), strict=True):
        number = _covering(found.labels, truth == label)
        segments = [one for one in found.objects if one.id == number]
        if not segments or found.plane is None or iou == 0.0:
            result.append(GraspedObject(0.0, None))
            continue
        seen = _jittered(segments[0].cloud, jitter_mm)
        target = FoundObject(str(number), seen, found.plane, segments[0].pixels, (truth.shape[0], truth.shape[1]))
        result.append(_grasped(pipeline, target, iou))
    return result, len(found.objects)


def _object_labels(truth: Int32) -> range:
    return range(FIRST_OBJECT, int(truth.max()) + 1)


def _grasp_real(pipeline: Pipeline, cloud: Cloud, jitter_mm: float = 0.0) -> GraspedObject:
    """A real object on its own, with the table that is assumed below it."""
    return _grasped(pipeline, FoundObject("1", _jittered(cloud, jitter_mm), ASSUMED_TABLE))


def _jittered(cloud: Cloud, jitter_mm: float) -> Cloud:
    if not jitter_mm:
        return cloud
    noise = np.random.default_rng(0).normal(0.0, 1e-3 * jitter_mm, cloud.xyz.shape)
    return Cloud((cloud.xyz + noise).astype(np.float32))


def _grasped(pipeline: Pipeline, target: FoundObject, iou: float | None = None) -> GraspedObject:
    grasps = pipeline.plan(target).grasps
    if not grasps:
        return GraspedObject(iou, target)
    found = GraspedObject(iou, target, np.stack([grasps[0].g1, grasps[0].g2]))
    (predicted,) = pipeline.predict(target, grasps[:1])
    if predicted.value is None or predicted.lower is None or predicted.upper is None:
        return found
    half = (predicted.upper.values - predicted.lower.values) / 2.0
    return replace(found, touch=predicted.value.values, half=half)


@lru_cache(maxsize=1)
def _shipped(data: PerceptionData) -> tuple[list[list[GraspedObject]], list[GraspedObject]]:
    pipeline = _pipeline(_UNCHANGED)
    return [_grasp_objects(pipeline, one)[0] for one in data.scenes], [_grasp_real(pipeline, one) for one in data.real]


@lru_cache(maxsize=4096)
def _scorer(found: FoundObject) -> OriginalScore | None:
    scorer = original_score(found.cloud, found.plane)
    return scorer if scorer is not None and scorer.has_axis else None


def _run(cell: Cell, _settings: PerceptionSettings, data: PerceptionData) -> list[Row]:
    """A row for each object."""
    pipeline, jitter_mm = _pipeline(cell.values), cell.values.get("jitter_mm", 0.0)
    before, real_before = _shipped(data)
    rows = []
    for number, (scene, shipped) in enumerate(zip(data.scenes, before, strict=True)):
        changed, count = _grasp_objects(pipeline, scene, jitter_mm)
        wrong = count != len(_object_labels(scene[1]))
        pairs = zip(changed, shipped, strict=True)
        rows += [{"scene": number, "wrong": wrong, **_compared(one, other)} for one, other in pairs]
    if cell.values["step"] != SEGMENTATION:
        pairs = zip((_grasp_real(pipeline, cloud, jitter_mm) for cloud in data.real), real_before, strict=True)
        rows += [
            {"scene": number, "wrong": False, **_compared(one, other)}
            for number, (one, other) in enumerate(pairs, len(data.scenes))
        ]
    return rows


def _compared(one: GraspedObject, shipped: GraspedObject) -> Row:
    """An object against the same with the shipped settings; what cannot be compared is None."""
    row: Row = dict.fromkeys(("score", "score_change", "touch_counts", "touch_half", "moved"))
    row |= {"iou": one.iou, "grasped": one.contacts is not None}
    if one.contacts is None or shipped.contacts is None or shipped.found is None:
        return row
    row["moved"] = bool(1e3 * np.linalg.norm(one.contacts - shipped.contacts, axis=1).max() > _MOVED_MM)
    if (scorer := _scorer(shipped.found)) is not None:
        score, before = scorer(one.contacts)[0], scorer(shipped.contacts)[0]
        if np.isfinite([score, before]).all():
            row |= {"score": score, "score_change": score - before}
    if one.touch is not None and shipped.touch is not None and shipped.half is not None:
        change = np.abs(one.touch - shipped.touch)
        row |= {"touch_counts": float(change.mean()), "touch_half": float((change / shipped.half).mean())}
    return row


def _tabulate(_settings: PerceptionSettings, rows: Sequence[Row]) -> list[Row]:
    """A row for each variant: masks of a segmentation, scores of a GeoGrasp, and what both do to grasps and touch."""
    result = []
    for name, own in grouped(rows, "variant"):
        masks = own[0]["step"] == SEGMENTATION
        row: Row = {"variant": name, **_interval("iou", own if masks else [])}
        row |= {
            "iou_least": min(one["iou"] for one in own) if masks else None,
            "wrong_scenes": len({one["scene"] for one in own if one["wrong"]}) if masks else None,
            **_interval("score", [] if masks else own),
            "objects": len(own),
            "no_grasp": sum(not one["grasped"] for one in own),
            "moved": _mean(own, "moved"),
            **_interval("score_change", own),
        }
        real = [one for one in own if one["iou"] is None]
        row |= {f"{key}_real": _mean(real, key) for key in ("touch_counts", "touch_half")}
        result.append(row)
    return result


def _mean(rows: Sequence[Row], key: str) -> float | None:
    values = [row[key] for row in rows if row[key] is not None]
    return float(np.mean(values)) if values else None


def _interval(key: str, rows: Sequence[Row]) -> Row:
    """Mean over objects, and its 95 % interval by drawing scenes."""
    known = [row for row in rows if row[key] is not None]
    if not known:
        return interval_columns(key, None)
    numbers, scene = np.unique([row["scene"] for row in known], return_inverse=True)
    sums = np.bincount(scene, [row[key] for row in known])
    counts = np.bincount(scene)
    drawn = np.random.default_rng(0).integers(0, len(numbers), (_DRAWS, len(numbers)))
    low, high = np.percentile(sums[drawn].sum(axis=1) / counts[drawn].sum(axis=1), (2.5, 97.5))
    return interval_columns(key, ScoreEstimate(float(sums.sum() / counts.sum()), float(low), float(high)))


def _timed(variant: Variant, settings: PerceptionSettings, data: PerceptionData) -> Timed:
    """See `Area.timed`: segments generated scenes, or plans grasps on their objects, one after the other."""
    pipeline = _pipeline(variant.values)
    clouds = cycle([cloud for cloud, _ in data.scenes[: min(_TIMED, settings.scenes)]])
    targets = cycle(_timed_targets(data))
    if variant.values["step"] == SEGMENTATION:
        return lambda _: pipeline.segment(next(clouds)), 1.0
    return lambda _: pipeline.plan(next(targets)), 1.0


@lru_cache(maxsize=1)
def _timed_targets(data: PerceptionData) -> list[FoundObject]:
    """Objects of all sizes: of the generated scenes, by number of points, evenly spread."""
    found = [one for scene in data.scenes[:_TIMED] for one in _grasp_objects(_pipeline(_UNCHANGED), scene)[0]]
    targets = sorted((one.found for one in found if one.found is not None), key=lambda one: one.cloud.size)
    return [targets[k] for k in np.linspace(0, len(targets) - 1, min(_TIMED, len(targets))).astype(int)]


EXPERIMENT = Area(
    name="tradeoff_perception",
    question="How well can objects and grasps be found in a few milliseconds?",
    module=__name__,
    settings=PerceptionSettings,
    presets={"small": {"scenes": 8, "real": 12, "detail": "few", "timing_s": 25.0}, "full": {"timing_s": 150.0}},
    prepare=_prepare,
    load=_load,
    cells=variant_cells(_variants),
    run=_run,
    tabulate=_tabulate,
    data_folder="",
    variants=_variants,
    timed=_timed,
    skills={"iou": "mean IoU of the objects, 95 % interval", "score": "mean original score, 95 % interval"},
    panels=(
        Panel("iou", 1, "Segmentation, 848x480: masks of the objects"),
        Panel("score", 1, "GeoGrasp: score of the best grasp at full resolution"),
    ),
)
