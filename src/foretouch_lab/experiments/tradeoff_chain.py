# SPDX-License-Identifier: Apache-2.0
"""The chain, area `chain`: from a depth image to predicted touch, settings of all steps together.

chain   share of objects found x share of first grasps that hold x skill of the predicted touch
found   of all objects in the images, at IoU 0.6 or more
held    of the first grasps on the objects that the hand can touch, where these are found
touch   explained share of the variance of the readings, averaged over the modalities; 0 is the mean of the training readings

Each image holds an object among others, which the hand takes (`shared.touched_scenes`, which says what holds):

    apart      one that the model `simulated` was trained on; the camera has no fault but its steps of 1 mm
    touching   one of these; others touch it, and the camera has all faults
    YCB        a household object that the model never saw, touched by others, and the camera has all faults; only with
               --data, a folder of the YCB set, which is FORETOUCH_DATA/ycb by default

The truth of touch is what the simulated hand reads in the grasp that was planned. *+ readings* adapts to the tare before each
grasp and to all grasps in the images before, on other objects. The call that is timed makes a cloud of a depth image, finds all
objects, plans one grasp on the nearest and predicts its touch.
"""

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import cycle
from pathlib import Path
from typing import Any, Final, cast

import numpy as np

from foretouch.errors import ConfigError
from foretouch.models.contact.estimator import ContactEstimator
from foretouch.models.registry import SIMULATED_HAND_MODEL, load_model
from foretouch.models.touch_model import History, TouchModel
from foretouch.pipeline import preset_files, preset_settings
from foretouch.tactile import MODALITIES
from foretouch.tactile.channels import BIOTAC
from foretouch.types import Float64, Grasps, Touch
from foretouch.types.scene import Object
from foretouch_lab.experiments.framework.experiment import Row, Table
from foretouch_lab.experiments.framework.tradeoff import Panel, Timed, Variant, frontier, late_time, make_area
from foretouch_lab.experiments.shared.touched_scenes import FOUND, HARD, TIMED, SceneSettings, TouchedScenes, drawn_rows
from foretouch_lab.experiments.tradeoff_model import PAUSE_S, READINGS, MeanPredictor, fewer_trees

_CONTACT: Final = "contact"
_MEAN: Final = "mean"
_TREES: Final = 10
_FORMS: Final = (f"{_TREES} trees", _CONTACT, _CONTACT + READINGS)
_MADE: Final = {"trees": f"a model that is trained with contact.trees={_TREES}", READINGS: "readings of the hand"}
_SMALLER: Final = {2: 40, 4: 12}  # by the stride of the image: least points of an object
_PRESETS: Final = {frozenset(preset_settings(name).items()): name for name in preset_files()}
_BETWEEN_NS: Final = 100_000_000_000  # from one grasp to the next
_STEPS: Final = ("found", "held", "touch")
_APART, _TOUCHING, _YCB = _PARTS = ("apart", "touching", "YCB")
_MESH: Final = "collision_vhacd.obj"
_YCB_KG: Final = 0.1  # of each object of the YCB set
_COUNTS: Final = 4  # columns before the errors: objects, those found, first grasps, those that hold


@dataclass(frozen=True, eq=False)
class Images:
    """The images, by name of their part."""

    parts: Mapping[str, TouchedScenes]

    @property
    def sha256(self) -> str:
        """Hash of all."""
        return hashlib.sha256("".join(part.sha256 for part in self.parts.values()).encode()).hexdigest()


Grasped = tuple[int, Object, Grasps, Touch, Touch]
"""Number of an image, its first object, the planned grasp, the tare and the reading."""


def _variants() -> Iterator[Variant]:
    """Iterate over settings of all steps; `values` holds the stride of the image, the form of the model and settings."""
    both = (500, 8000)  # points
    perceived = [*((1, grid, points) for grid in (60, 120, 240) for points in both), (1, 120, 2000), (1, 480, 0)]
    perceived += [*((2, grid, points) for grid in (60, 120) for points in both), (4, 120, 500)]
    for stride, grid, points in perceived:
        changes: dict[str, Any] = {"segmentation.grid_rows": grid, "grasp.max_points": points}
        if stride in _SMALLER:
            changes["segmentation.clusters.min_points"] = _SMALLER[stride]
        preset = _PRESETS.get(frozenset(changes.items()), "") if stride == 1 else ""
        shown = f"grid {grid}, {points} points" if points else "every pixel and point"
        name = f"{f'{preset}: ' if preset else ''}{640 // stride}x{480 // stride}, {shown}"
        few = preset == "default" or (stride, grid, points) == (2, 60, 500)
        for form in (*_FORMS, *((_MEAN, _MEAN + READINGS) if few else ())):
            shipped = preset == "default" and form.startswith(_CONTACT)
            values = {"stride": stride, "form": form, "changes": {"preset": preset} if preset else changes}
            yield Variant(f"{name}, {form}", "shipped" if shipped else form, values)
    original = {"grasp.method": "original"}
    yield Variant(
        "640x480, original GeoGrasp, contact", "reference", {"stride": 1, "form": _CONTACT, "changes": original}
    )


VARIANTS: Final = tuple(_variants())


@lru_cache(maxsize=8)
def model_of(form: str) -> TouchModel:
    """Return the model of the simulated hand in a form: as shipped, with fewer trees, or its mean alone."""
    shipped = load_model(SIMULATED_HAND_MODEL)
    if form.startswith(_MEAN):
        return TouchModel(MeanPredictor(shipped), shipped.card, shipped.calibration)
    if form.startswith(_CONTACT):
        return shipped
    estimator = fewer_trees(cast("ContactEstimator", shipped.predictor), _TREES)
    return TouchModel(estimator, shipped.card, shipped.calibration)


def _perceive(data: TouchedScenes, stride: int, changes: Mapping[str, Any]) -> tuple[Float64, list[Grasped]]:
    """Return (S, 4) counts of each image (see `_COUNTS`), and the grasps that hold."""
    pipeline, counts, grasped = data.pipeline(changes), np.zeros((len(data), _COUNTS)), list[Grasped]()
    for k, row in enumerate(counts):
        scene = pipeline.segment(data.cloud(k, stride))
        shares = np.array(data.overlaps(k, scene.labels, stride))
        row[:2] = len(shares), (shares >= FOUND).sum()
        if (target := data.wanted(k, scene, stride)) is None:
            continue
        row[2], grasps = 1.0, pipeline.plan(target).grasps
        if grasps and (read := data.read(k, grasps[0])) is not None:
            row[3] = 1.0
            grasped.append((k, target, grasps, read[1], read[0]))
    return counts, grasped


def _errors(data: TouchedScenes, grasped: Sequence[Grasped], form: str) -> Float64:
    """Return (S, 2 D) squared errors of the predictions by a form of the model, and of the mean of the training, by image."""
    model, errors = model_of(form), np.zeros((len(data), 2, BIOTAC.size))
    mean, history = model_of(_MEAN), History(model)
    for k, target, grasps, tare, reading in grasped:
        now = (k + 1) * _BETWEEN_NS
        if form.endswith(READINGS):
            history.tare(tare, stamp_ns=now - 2)
            predicted = history.predict(target, grasps, stamp_ns=now - 1, same_object=False).value[0]
            history.touched(target, grasps[0], reading, stamp_ns=now, same_object=False)
        else:
            predicted = model.predict(target, grasps).value[0]
        reference = mean.estimate(target.cloud, grasps, target.plane).counts[0]
        predicted = np.where(np.isfinite(predicted), predicted, reference)  # of a refused one
        errors[k] = (predicted - reading.values) ** 2, (reference - reading.values) ** 2
    return errors.reshape(len(data), -1)


def steps(sums: Float64) -> Float64:
    """Return (3, ...) found, held and skill of touch of sums (..., C) of images; 0 without a grasp."""
    objects, found, grasps, held = np.moveaxis(sums[..., :_COUNTS], -1, 0)
    squared, reference = np.split(sums[..., _COUNTS:], 2, axis=-1)
    explained = np.where(reference > 0.0, 1.0 - squared / np.maximum(reference, 1e-9), 0.0)
    touch = np.mean([explained[..., BIOTAC.columns([name])].mean(axis=-1) for name in MODALITIES], axis=0)
    return np.stack([found / np.maximum(objects, 1.0), held / np.maximum(grasps, 1.0), touch])


def _sums(variants: Sequence[Variant], scenes: TouchedScenes) -> dict[str, Float64]:
    """Return (S, C) sums of each image by variant: counts and errors. Settings that several share are measured once."""
    perceived: dict[str, tuple[Float64, list[Grasped]]] = {}
    sums: dict[str, Float64] = {}
    for name, _, values in variants:
        key = repr((values["stride"], values["changes"]))
        if key not in perceived:
            perceived[key] = _perceive(scenes, values["stride"], values["changes"])
        counts, grasped = perceived[key]
        sums[name] = np.hstack([counts, _errors(scenes, grasped, values["form"])])
    return sums


def _accuracy(skill: str, settings: SceneSettings, data: Images) -> Mapping[str, Row]:
    by_part = {part: _sums(VARIANTS, scenes) for part, scenes in data.parts.items()}
    sums = {one.name: np.vstack([own[one.name] for own in by_part.values()]) for one in VARIANTS}
    rows = drawn_rows(skill, sums, _product, settings.bootstrap)
    for name, row in rows.items():
        row |= dict(zip(_STEPS, steps(sums[name].sum(axis=0)).tolist(), strict=True))
        row |= {part: float(_product(own[name].sum(axis=0))) for part, own in by_part.items()}
    return rows


def _product(sums: Float64) -> Float64:
    """Return the product of the shares of sums (..., C) of images."""
    return np.asarray(steps(sums).prod(axis=0), np.float64)


def _timed(variant: Variant, _settings: SceneSettings, data: Images) -> Timed:
    """Return what answers depth images, one after the other, of all parts in turn."""
    stride, form, known = variant.values["stride"], variant.values["form"], data.parts[_APART]
    pipeline, model = known.pipeline({"target.mode": "nearest", **variant.values["changes"]}), model_of(form)
    history = None
    if form.endswith(READINGS):
        history = History(model)
        for k, target, grasps, tare, reading in _perceive(known.first(TIMED), stride, variant.values["changes"])[1]:
            history.tare(tare, stamp_ns=2 * k * _BETWEEN_NS)
            history.touched(target, grasps[0], reading, stamp_ns=(2 * k + 1) * _BETWEEN_NS, same_object=False)
    turn = cycle([(part, k) for k in range(min(TIMED, len(known))) for part in data.parts.values()])
    now = 3 * TIMED * _BETWEEN_NS

    def answer(_: int) -> object:
        part, number = next(turn)
        scene = pipeline.segment(part.cloud(number, stride))
        grasps = pipeline.plan(scene.targets[0]).grasps if scene.targets else ()
        if not grasps:
            return scene
        if history is not None:
            return history.predict(scene.targets[0], grasps, stamp_ns=now, same_object=False)
        return model.predict(scene.targets[0], grasps)

    return answer, 1.0


def settings_text(variant: Variant) -> str:
    """Return the settings of a variant as a user gives them."""
    words = [f"{name}={value}" for name, value in variant.values["changes"].items()]
    if variant.values["stride"] > 1:
        words.insert(0, f"an image of {640 // variant.values['stride']} columns")
    words += [text for form, text in _MADE.items() if form in variant.values["form"]]
    return ", ".join(words)


def _summarise(rows: Sequence[Row]) -> list[Table]:
    """Return the frontier with its steps, its times and what to set."""
    named = {variant.name: variant for variant in VARIANTS}
    line = {row["variant"] for row in frontier(rows, _PANEL)}
    presets = tuple(f"{preset}:" for preset in _PRESETS.values())
    column = late_time(rows)
    parts = [name for name in _PARTS if name in rows[0]]
    body = [
        [
            ("• " if row["variant"] in line else "") + row["variant"],
            *(f"{row[name]:.2f}" for name in ("chain", *parts, *_STEPS)),
            *(f"{row[name]:.3g}" for name in ("ms_p50", "ms_p95", "cpu_ms", "cpu_ms_p95")),
            settings_text(named[row["variant"]]) if row["variant"] in named else "",
        ]
        for row in sorted(rows, key=lambda row: row[column])
        if row["variant"] in line or (row["variant"].startswith(presets) and _CONTACT in row["variant"])
    ]
    default = next(row for row in rows if row["variant"].startswith("default:") and row["variant"].endswith(READINGS))
    best = max((row for row in rows if row[column] <= default[column]), key=lambda row: row["chain"])
    text = f"The default with readings has a product of {default['chain']:.3f}. Of the settings that take no longer (p95), "
    notes = [
        "•: on the frontier of the product and the median time; in the order of p95. Other processes disturb the wall time of a loaded machine.",
        f"{', '.join(parts)}: the product on each part of the images.",
        f"{text}{best['variant']} has the largest one, {best['chain']:.3f}.",
    ]
    columns = [
        "",
        "product",
        *parts,
        *_STEPS,
        *(f"{kind} {part} [ms]" for kind in ("wall", "CPU") for part in ("p50", "p95")),
        "set",
    ]
    return [Table("The frontier and the presets, by time", columns, body, notes)]


def _load(settings: SceneSettings, path: Path) -> Images:
    """Render the images: equally many of each part."""
    parts: dict[str, Mapping[str, Any]] = {_APART: {}, _TOUCHING: HARD}
    if meshes := sorted(path.glob(f"*/{_MESH}")):
        mesh = {"shape": "mesh", "size_m": [], "mass_kg": _YCB_KG}
        objects = [{**mesh, "name": file.parent.name, "file": str(file)} for file in meshes]
        parts[_YCB] = {**HARD, "families": [], "objects": objects}
    count = -(-settings.scenes // len(parts))
    return Images({part: TouchedScenes.render(count, changes) for part, changes in parts.items()})


def _ycb_folder(_settings: SceneSettings, source: Path | None, out: Path) -> Path:
    """Return the folder of the YCB set, or any folder if none is given: the other images are generated."""
    if source is not None and not any(source.glob(f"*/{_MESH}")):
        raise ConfigError(f"--data {source}: holds no <object>/{_MESH} of the YCB set; leave it out to go without")
    return source or out


_PANEL: Final = Panel(
    "chain", 1, "From a depth image to predicted touch", "objects found x grasps that hold x skill of touch"
)
EXPERIMENT = make_area(
    _accuracy,
    name="tradeoff_chain",
    question="What do I get in 5, 10, 30 or 100 ms, from a depth image to predicted touch?",
    module=__name__,
    settings=SceneSettings,
    presets={
        "smoke": {"scenes": 4, "timing_s": 2.0},
        "small": {"scenes": 160, "timing_s": 180.0, "pause_s": PAUSE_S},
        "full": {"timing_s": 600.0, "pause_s": PAUSE_S},
    },
    prepare=_ycb_folder,
    load=_load,
    summarise=_summarise,
    variants=VARIANTS,
    timed=_timed,
    panels=(_PANEL,),
    data_folder="ycb",
    goes_without=True,
)
