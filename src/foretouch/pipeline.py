# SPDX-License-Identifier: Apache-2.0
"""The pipeline from a cloud to predicted touch, shared by the nodes and the command line.

    scene cloud ─ segment ─► objects + table ─ plan ─► grasps ─ predict ─► touch

Each step is one method over the public function of its package, so that the same input gives
bit-equal output wherever it is run.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any, Final, Self

import numpy as np
import numpy.typing as npt

from foretouch.cloud.geometry.limits import ObjectLimits, check_object, check_table
from foretouch.cloud.segmentation.identity import ObjectIdentity
from foretouch.cloud.segmentation.masks import segment_mask
from foretouch.cloud.segmentation.objects import AMBIGUOUS_TARGET, TargetConfig, select_free, select_targets
from foretouch.cloud.segmentation.segment import SegmentationConfig, segment
from foretouch.cloud.timing import timed
from foretouch.config import Settings, description_file, flattened, load_yaml, setting
from foretouch.errors import CloudError, ConfigError, require_type, shown
from foretouch.grasp import CarriedConfig, GeoGraspConfig, GraspPlan, HandConfig, HeldGrasp, plan_grasps, with_rotations
from foretouch.grasp.reach import ReachConfig, check_reach
from foretouch.grasp.unseen import DepthAround
from foretouch.models import History, Readings, TouchModel, load_model
from foretouch.models.registry import MODEL_WORDS, PREDICTOR_WORDS
from foretouch.types import Cloud, Float64, Grasp, Grasps, Plane, Predictions, Touch
from foretouch.types.arrays import numbers, scalar
from foretouch.types.cloud import require_cloud
from foretouch.types.scene import Object, Obstacles, Scene
from foretouch.types.summary import Summarised

PRESET: Final = "preset"
"""Key that stands for the settings of a preset."""
PRESET_WORDS: Final = "Settings of all steps together: fast, default, exact, or a YAML file; what is set besides counts"


@cache
def preset_files() -> dict[str, Path]:
    """Return the presets that come with the package, by name."""
    folder = Path(str(resources.files("foretouch"))) / "presets"
    return {path.stem: path for path in sorted(folder.glob("*.yaml"))}


def preset_settings(name: str) -> dict[str, Any]:
    """Return the settings of a preset by dotted name.

    Args:
        name: Of a preset of the package, or a YAML file of settings of the pipeline.

    Raises:
        ConfigError: If there is none, or it breaks a rule; names file, setting and rule.
    """
    try:
        file = description_file(name, preset_files())
    except ConfigError as err:
        raise ConfigError(f"{PRESET}: {err}") from err
    stated = flattened(load_yaml(file))
    if PRESET in stated:
        raise ConfigError(f"{shown(file)}: {PRESET}: a preset holds no other one")
    PipelineConfig.from_mapping(stated, str(file))
    return stated


def _with_preset(changes: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return settings with those of the preset that they name in its place, which count less."""
    if not isinstance(changes, Mapping) or PRESET not in changes:
        return changes
    others = {name: value for name, value in changes.items() if name != PRESET}
    return preset_settings(changes[PRESET]) | flattened(others)


@dataclass(frozen=True, kw_only=True, repr=False)
class PipelineConfig(Summarised, Settings):
    """Settings of the pipeline, one group for each step; `updated({"preset": "fast"})` changes those of a preset."""

    segmentation: SegmentationConfig = SegmentationConfig()
    target: TargetConfig = TargetConfig()
    limits: ObjectLimits = ObjectLimits()
    grasp: GeoGraspConfig = GeoGraspConfig()
    hand: HandConfig = HandConfig()
    object: CarriedConfig = CarriedConfig()
    reach: ReachConfig = ReachConfig()
    model: str = setting("default", MODEL_WORDS, read_only=True)
    predictor: str = setting("", PREDICTOR_WORDS, read_only=True)

    @classmethod
    def from_mapping(cls, mapping: Mapping[str, Any], source: str = "") -> Self:
        """Make settings from plain data, which may name a preset, as `Settings.from_mapping` does."""
        return super().from_mapping(_with_preset(mapping), source)

    def updated(self, changes: Mapping[str, Any], source: str = "") -> Self:
        """Return a copy with some settings changed, or those of a preset, as `Settings.updated` does."""
        return super().updated(_with_preset(changes), source)

    def _summary(self) -> tuple[str, dict[str, str]]:
        defaults = flattened(type(self)().to_mapping())
        changed = {name: value for name, value in flattened(self.to_mapping()).items() if value != defaults.get(name)}
        return "other than the defaults:" if changed else "defaults", {k: shown(v) for k, v in changed.items()}


@dataclass(frozen=True, eq=False, repr=False)
class TargetResult(Summarised):
    """One object with its planned grasps and the predictions for them, in the same order."""

    target: Object
    plan: GraspPlan
    predictions: Predictions


@dataclass(frozen=True, eq=False, repr=False)
class PipelineResult(Summarised):
    """The result for one cloud."""

    status: str  # "ok" if there is a prediction; else the status of the step at which the pipeline ended, or of the first grasp
    reason: str  # why, in words; "" for "ok"
    scene: Scene | None  # none where the cloud holds only an object
    targets: tuple[TargetResult, ...]  # the objects to grasp with their predictions, best first
    ms: dict[str, float]  # wall time of the steps `segment`, `grasp`, `touch` that ran, and `total` [ms]

    @classmethod
    def of(cls, scene: Scene | None, results: Sequence[TargetResult], ms: dict[str, float]) -> Self:
        """Combine the results of all targets.

        Args:
            scene: The scene; None where the cloud holds only an object.
            results: Of each target; there is one without a scene.
            ms: Wall time of the steps [ms].
        """
        ms = ms | {"total": sum(ms.values())}
        refused = None
        for result in results:
            if result.predictions.ok.any():
                return cls("ok", "", scene, tuple(results), ms)
            if refused is None and result.predictions:
                refused = result.predictions[0]
        last: Any = refused or (results[0].plan if results else scene)
        return cls(last.status, last.reason, scene, tuple(results), ms)


class Pipeline(Summarised):
    """Runs the steps from a cloud to predicted touch.

    Args:
        config: Settings of all steps; the defaults if None. The touch model is loaded when it is first needed.

    Raises:
        ConfigError: If the settings are of another type.
    """

    def __init__(self, config: PipelineConfig | None = None) -> None:
        rule = 'not a PipelineConfig, such as PipelineConfig().updated({"grasp.count": 3}, "mine")'
        require_type(config, PipelineConfig | None, "config", rule, ConfigError)
        self.config = config if config is not None else PipelineConfig()
        self._model: TouchModel | None = None

    def _summary(self) -> tuple[str, Mapping[str, str]]:
        title, facts = self.config._summary()  # noqa: SLF001  of this module
        return f"settings: {title}", facts

    @property
    def model(self) -> TouchModel:
        """The touch model, loaded once; a `ForetouchError` if it is absent or damaged."""
        if self._model is None:
            self._model = load_model(self.config.model, self.config.predictor or None)
        return self._model

    def segment(
        self,
        cloud: Cloud,
        previous: Float64 | None = None,
        identity: ObjectIdentity | None = None,
        *,
        mask: npt.ArrayLike | None = None,
    ) -> Scene:
        """Find the table and the target objects in a cloud with the table in view.

        Args:
            cloud: (H, W, 3) or (N, 3) points.
            previous: (3,) float64 [m], centroid of the target in the previous cloud of a stream; of objects that fit
                the rule equally well, it stays the target.
            identity: Ids of the objects in the stream; without, ids are numbers by distance. Not used with a mask.
            mask: (H, W) integers or bool, labels of the objects in the image; 0 and negative numbers are no object. The
                table is found in the rest of the image, and the labels are the ids.

        Raises:
            CloudError: If the mask has another size than the image or no label, or its numbers are not whole; or an array
                is passed for the cloud.
        """
        require_cloud(cloud)
        require_type(identity, ObjectIdentity | None, "identity", "not an ObjectIdentity", CloudError)
        if previous is not None and (previous := numbers(previous, "previous", CloudError)).shape != (3,):
            raise CloudError(f"previous: shape {previous.shape} is not (3,), a centroid; pass mask= for labels")
        if mask is not None:
            scene, identity = segment_mask(cloud, mask, self.config.segmentation), None
        else:
            scene = segment(cloud, self.config.segmentation)
        ids = [object_.id for object_ in scene.objects] if identity is None else identity.ids(scene)
        if scene.status != "ok":
            return scene
        solid = [(0, part.cloud.xyz) for part in scene.background if part.background != "floating"]
        named = list(zip(ids, scene.objects, strict=True))
        obstacles = Obstacles.of([*((int(name), object_.cloud.xyz) for name, object_ in named), *solid])
        image = scene.cloud if scene.cloud.organised else None
        objects = tuple(replace(object_, id=name, obstacles=obstacles, image=image) for name, object_ in named)
        rule = self.config.target
        if rule.mode == "free" and objects:
            chosen, reason = select_free(objects, rule, self._loss, previous)
        else:
            chosen, reason = select_targets(objects, rule, previous)
        if reason.startswith(AMBIGUOUS_TARGET):
            chosen = [replace(target, flags=(*target.flags, AMBIGUOUS_TARGET)) for target in chosen]
        return replace(
            scene,
            status="ok" if chosen else "no_target",
            reason=reason or scene.reason,
            objects=objects,
            targets=tuple(chosen),
            obstacles=obstacles,
        )

    def _loss(self, target: Object) -> tuple[float, str]:
        """Return the score that other objects cost the best grasp of an object, infinite if it has none; and why."""
        plan = self.plan(target)
        if not plan.grasps:
            return np.inf, f"has no grasp ({plan.reason})"
        return plan.lost, f"is blocked by object {', '.join(map(str, plan.blocked_by))}"

    def plan(
        self,
        target: Object,
        *,
        slide_m: float = 0.0,
        rng: np.random.Generator | None = None,
        held: HeldGrasp | None = None,
        hold: float = 0.0,
    ) -> GraspPlan:
        """Return grasps for one object, best first (see `foretouch.grasp.plan_grasps`).

        Args:
            target: The object.
            slide_m: Shift of the grasp plane along the object's axis [m].
            rng: Draws a random shift instead, where given.
            held: Grasp of the previous cloud, which is kept unless another is better by more than `hold`.
            hold: In units of the score.

        Raises:
            CloudError: If a scene, a cloud or background is passed for the object.
        """
        require_object(target)
        kinds = np.random.Generator | np.random.RandomState | None
        require_type(rng, kinds, "rng", "not a generator, such as numpy.random.default_rng(0)", ConfigError)
        require_type(held, tuple | None, "held", "not a grasp and a number, as of GraspHold", ConfigError)
        slide_m = scalar(slide_m, "slide_m", ConfigError)
        if target.background:
            raise CloudError(f"target: is background ({target.background}); grasps are planned on objects of a scene")
        return plan_grasps(
            target.cloud,
            target.plane,
            self.config.grasp,
            slide_m=slide_m,
            rng=rng,
            pixels=target.pixels if target.image_shape else None,
            image_shape=target.image_shape,
            limits=self.config.limits,
            held=held,
            hold=hold,
            hand=self.config.hand,
            carried=self.config.object,
            obstacles=None if target.obstacles is None else target.obstacles.without(target),
            around=DepthAround.of(target) if self.config.grasp.method == "completed" else None,
            object_id=target.id,
        )

    def grasp_between(self, target: Object, g1: Float64, g2: Float64) -> Grasp:
        """Make the grasp with given contacts, and the rotation that GeoGrasp computes for them.

        Args:
            target: The object.
            g1: (3,) float64 [m], contact of the first finger, in the cloud's frame.
            g2: (3,) float64 [m], contact of the second.

        Raises:
            GraspError: If a contact is not finite, both are equal, or they are out of the hand's reach.
            CloudError: If the object or its table is out of the limits.
        """
        require_object(target)
        grasp = Grasp(g1, g2, object_id=target.id)
        check_object(target.cloud.xyz, self.config.limits)
        check_table(target.plane, self.config.limits, target.cloud.xyz)
        check_reach(grasp, target.cloud.xyz, self.config.reach.max_width_m, self.config.reach.max_distance_m)
        return with_rotations(Grasps.of([grasp]), target.cloud, target.plane, self.config.grasp)[0]

    def predict(
        self,
        target: Object,
        grasps: Sequence[Grasp],
        *,
        tare: Touch | None = None,
        history: History | Readings | None = None,
    ) -> Predictions:
        """Predict touch for each grasp on one object (see `TouchModel.predict`).

        Args:
            target: The object.
            grasps: K grasps in the frame of its cloud.
            tare: A reading without contact, taken shortly before.
            history: Readings of the hand so far; `tare` must be omitted.

        Returns:
            A row for each grasp, in order.
        """
        require_object(target)
        model, grasps = self.model, Grasps.of(grasps)
        if not grasps:
            return Predictions.refused(grasps, model.sensor.channels, "refused", "")
        grasps = with_rotations(grasps, target.cloud, target.plane, self.config.grasp)
        return model.predict(
            target, grasps, tare=tare, history=history, limits=self.config.limits, reach=self.config.reach
        )

    def run(self, cloud: Cloud, plane: Plane | None = None, *, mask: npt.ArrayLike | None = None) -> PipelineResult:
        """Run all steps, from a cloud to predicted touch.

        Args:
            cloud: Of the whole scene, or of one object if the table is given.
            plane: The table, in the cloud's frame.
            mask: Labels of the objects, as in `segment`.

        Raises:
            CloudError: If the cloud or the table is of another type, or table and mask are given; for a mask as `segment`.
        """
        ms: dict[str, float] = {}
        scene: Scene | None = None
        results: list[TargetResult] = []
        targets: tuple[Object, ...]
        if plane is not None:
            if mask is not None:
                raise CloudError("mask: is of a scene, and with plane the cloud is of one object; give one of them")
            targets = (Object.of("1", cloud, plane),)
        else:
            with timed(ms, "segment"):
                scene = self.segment(cloud, mask=mask)
            targets = scene.targets
        for target in targets:
            with timed(ms, "grasp"):
                plan = self.plan(target)
            with timed(ms, "touch"):
                results.append(TargetResult(target, plan, self.predict(target, plan.grasps)))
        return PipelineResult.of(scene, results, ms)


def require_object(target: Any) -> None:
    """Refuse what is no object of a scene, with a `CloudError` that says how to get one."""
    rule = "not an object of a scene, such as segment(cloud).objects[0]; Pipeline().run(cloud, plane) takes one object's points"
    require_type(target, Object, "target", rule, CloudError)
