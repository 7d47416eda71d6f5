# SPDX-License-Identifier: Apache-2.0
"""The pipeline from a cloud to predicted touch, shared by the nodes and the command line.

    scene cloud ─ segment ─► objects + table ─ plan ─► grasps ─ predict ─► touch

Each step is one method over the public function of its package, so that the same input gives
bit-equal output wherever it is run.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from foretouch.cloud.geometry.limits import ObjectLimits, check_object, check_table
from foretouch.cloud.segmentation.identity import ObjectIdentity
from foretouch.cloud.segmentation.objects import (
    AMBIGUOUS_TARGET,
    ObjectSegment,
    TargetConfig,
    select_free,
    select_targets,
)
from foretouch.cloud.segmentation.segment import Segmentation, SegmentationConfig, segment
from foretouch.cloud.timing import timed
from foretouch.config import Settings, setting
from foretouch.grasp import (
    GeoGraspConfig,
    GraspPlan,
    HandConfig,
    HeldGrasp,
    Obstacles,
    hand_rotation,
    object_axis,
    plan_grasps,
)
from foretouch.grasp.reach import ReachConfig, check_reach
from foretouch.models import TouchModel, load_model
from foretouch.models.touch_model import History
from foretouch.types import Cloud, Float64, Grasp, Int64, Plane, Touch, TouchPrediction


@dataclass(frozen=True, kw_only=True)
class PipelineConfig(Settings):
    """Settings of the pipeline, one group for each step."""

    segmentation: SegmentationConfig = SegmentationConfig()
    target: TargetConfig = TargetConfig()
    limits: ObjectLimits = ObjectLimits()
    grasp: GeoGraspConfig = GeoGraspConfig()
    hand: HandConfig = HandConfig()
    reach: ReachConfig = ReachConfig()
    model: str = setting("default", "Name of a model, or path of its card, weights or model folder", read_only=True)


@dataclass(frozen=True, eq=False)
class FoundObject:
    """One object and the table under it."""

    id: str  # unique within its cloud
    cloud: Cloud  # (N, 3), only the object's points
    plane: Plane  # the table, in the cloud's frame
    pixels: Int64 | None = None  # (N,) int64, flat index of each point in the image that it comes from, if any
    image_shape: tuple[int, int] | None = None  # (H, W) of that image
    flags: tuple[str, ...] = ()  # of its predictions: `ambiguous_target` if other objects fit the rule as well
    obstacles: Obstacles | None = None  # all objects of the scene, if there are several


@dataclass(frozen=True, eq=False)
class SegmentedScene:
    """The table and the objects of a scene."""

    status: str  # "ok", "no_target", or the status of the segmentation
    reason: str  # why, in words; for "ok" usually "", or how an ambiguous target was selected
    segmentation: Segmentation  # the table and all objects
    targets: tuple[FoundObject, ...]  # the objects to grasp, best first
    obstacles: Obstacles | None = None  # the points of all objects, if there are several


@dataclass(frozen=True, eq=False)
class TargetResult:
    """One object with its planned grasps and the predictions for them, in the same order."""

    target: FoundObject
    plan: GraspPlan
    predictions: tuple[TouchPrediction, ...]


@dataclass(frozen=True, eq=False)
class PipelineResult:
    """The result for one cloud."""

    status: str  # "ok", or the status of the step at which the pipeline ended
    reason: str  # why, in words; "" for "ok"
    scene: SegmentedScene | None  # none where the cloud holds only an object
    targets: tuple[TargetResult, ...]  # the objects to grasp with their predictions, best first
    ms: dict[str, float]  # wall time of the steps `segment`, `grasp`, `touch` that ran, and `total` [ms]


class Pipeline:
    """The steps with their settings and the touch model, which is loaded when first needed."""

    def __init__(self, config: PipelineConfig | None = None) -> None:
        self.config = config if config is not None else PipelineConfig()
        self._model: TouchModel | None = None

    @property
    def model(self) -> TouchModel:
        """The touch model, loaded once; raises as `load_model`."""
        if self._model is None:
            self._model = load_model(self.config.model)
        return self._model

    def segment(
        self, cloud: Cloud, previous: Float64 | None = None, identity: ObjectIdentity | None = None
    ) -> SegmentedScene:
        """Find the table and the target objects in a cloud with the table in view.

        Args:
            cloud: (H, W, 3) or (N, 3) points.
            previous: (3,) float64 [m], centroid of the target in the previous cloud of a stream; of objects that fit
                the rule equally well, it stays the target.
            identity: Ids of the objects in the stream; without, ids are numbers by distance.
        """
        found = segment(cloud, self.config.segmentation)
        if identity is not None:
            found = identity.keep(found)
        if found.status != "ok" or found.plane is None:
            return SegmentedScene(found.status, found.reason, found, ())
        plane = found.plane
        shape = (cloud.xyz.shape[0], cloud.xyz.shape[1]) if cloud.organised else None
        solid = [one for one in found.background if one.background != "floating"]
        obstacles = Obstacles.of([(one.id, one.cloud.xyz) for one in (*found.objects, *solid)])

        def target(one: ObjectSegment, flags: tuple[str, ...] = ()) -> FoundObject:
            pixels = one.pixels if shape else None
            return FoundObject(str(one.id), one.cloud, plane, pixels, shape, flags, obstacles)

        rule = self.config.target
        if rule.mode == "free" and found.objects:
            chosen, reason = select_free(found.objects, rule, lambda one: self._loss(target(one)), previous)
        else:
            chosen, reason = select_targets(found.objects, rule, previous)
        flags = (AMBIGUOUS_TARGET,) if reason.startswith(AMBIGUOUS_TARGET) else ()
        targets = tuple(target(one, flags) for one in chosen)
        return SegmentedScene("ok" if targets else "no_target", reason, found, targets, obstacles)

    def _loss(self, target: FoundObject) -> tuple[float, str]:
        """The score that other objects cost the best grasp of an object, infinite if it has none; and why."""
        plan = self.plan(target)
        if not plan.grasps:
            return np.inf, f"has no grasp ({plan.reason})"
        return plan.lost, f"is blocked by object {', '.join(map(str, plan.blocked_by))}"

    def plan(
        self,
        target: FoundObject,
        *,
        slide_m: float = 0.0,
        rng: np.random.Generator | None = None,
        held: HeldGrasp | None = None,
        hold: float = 0.0,
    ) -> GraspPlan:
        """Grasps for one object, best first (see `foretouch.grasp.plan_grasps`).

        Args:
            target: The object.
            slide_m: Shift of the grasp plane along the object's axis [m].
            rng: Draws a random shift instead, where given.
            held: Grasp of the previous cloud, which is kept unless another is better by more than `hold`.
            hold: In units of the score.
        """
        plan = plan_grasps(
            target.cloud,
            target.plane,
            self.config.grasp,
            slide_m=slide_m,
            rng=rng,
            pixels=target.pixels,
            image_shape=target.image_shape,
            limits=self.config.limits,
            held=held,
            hold=hold,
            hand=self.config.hand,
            obstacles=None if target.obstacles is None else target.obstacles.without(target.id),
        )
        return replace(plan, grasps=tuple(replace(grasp, object_id=target.id) for grasp in plan.grasps))

    def grasp_between(self, target: FoundObject, g1: Float64, g2: Float64) -> Grasp:
        """The grasp with given contacts (3,) [m] in the cloud frame, and the rotation that GeoGrasp computes for them.

        Raises:
            GraspError: If a contact is not finite, both are equal, or they are out of the hand's reach.
            CloudError: If the object or its table is out of the limits.
        """
        posed = Grasp(g1, g2, np.eye(3), object_id=target.id)
        check_object(target.cloud.xyz, self.config.limits)
        check_table(target.plane, self.config.limits)
        check_reach(posed, target.cloud.xyz, self.config.reach.max_width_m, self.config.reach.max_distance_m)
        axis, _ = object_axis(target.cloud, target.plane, self.config.grasp)
        return Grasp(g1, g2, hand_rotation(posed.g1, posed.g2, axis), object_id=target.id)

    def predict(
        self,
        target: FoundObject,
        grasps: Sequence[Grasp],
        *,
        tare: Touch | None = None,
        history: History | None = None,
        model: TouchModel | None = None,
    ) -> Sequence[TouchPrediction]:
        """Touch for each grasp on one object (see `TouchModel.predict`); the cloud's features are computed once.

        A `model` is used instead of the configured one.
        """
        if not grasps:
            return []
        predictions = (model or self.model).predict(
            target.cloud, grasps, tare=tare, history=history, limits=self.config.limits, reach=self.config.reach
        )
        if not target.flags:
            return predictions
        return [replace(one, flags=(*one.flags, *target.flags)) for one in predictions]

    def run(self, cloud: Cloud, plane: Plane | None = None) -> PipelineResult:
        """From a cloud to predicted touch.

        Args:
            cloud: Of the whole scene, or of one object if the table is given.
            plane: The table, in the cloud's frame.
        """
        ms: dict[str, float] = {}
        scene: SegmentedScene | None = None
        results: list[TargetResult] = []
        targets: tuple[FoundObject, ...]
        if plane is not None:
            targets = (FoundObject("1", cloud, plane),)
        else:
            with timed(ms, "segment"):
                scene = self.segment(cloud)
            targets = scene.targets
        for target in targets:
            with timed(ms, "grasp"):
                plan = self.plan(target)
            with timed(ms, "touch"):
                results.append(TargetResult(target, plan, tuple(self.predict(target, plan.grasps))))
        ms["total"] = sum(ms.values())
        status, reason = ("no_target", "") if scene is None else (scene.status, scene.reason)
        if results:
            ok, first = any(one.predictions for one in results), results[0].plan
            status, reason = ("ok", "") if ok else (first.status, first.reason)
        return PipelineResult(status, reason, scene, tuple(results), ms)
