# SPDX-License-Identifier: Apache-2.0
"""The one road from a cloud to predicted touch, shared by the nodes and the command line.

    scene cloud ─ see ─► objects + table ─ plan ─► grasps ─ feel ─► touch

Each step is one method over the public function of its package, so that the same input gives
bit-equal output wherever it is run.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from foretouch.cloud.segmentation import ObjectSegment, Segmentation, SegmentationConfig, TargetConfig, choose_targets, segment
from foretouch.config import Settings, setting
from foretouch.grasp import GeoGraspConfig, GraspPlan, plan_grasps
from foretouch.models import TouchModel, load_model
from foretouch.types import Cloud, Grasp, Plane, Touch, TouchPrediction

__all__ = ["ASSUMED_TABLE", "Felt", "Pipeline", "PipelineConfig", "PipelineResult"]

ASSUMED_TABLE = Plane.from_coefficients([0.0, 0.0, 1.0, -1.27])
"""The table of a cloud that holds an object and nothing else: seen from straight above, as in the public recordings."""


@dataclass(frozen=True, kw_only=True)
class PipelineConfig(Settings):
    """Settings of the whole road, one group a step."""

    segmentation: SegmentationConfig = SegmentationConfig()
    target: TargetConfig = TargetConfig()
    grasp: GeoGraspConfig = GeoGraspConfig()
    model: str = setting("default", "Name of a shipped model, or the path of a checkpoint", read_only=True)
    vary_seed: int | None = setting(None, "Slide each grasp along the object by a random amount drawn from this seed")


@dataclass(frozen=True, eq=False)
class Felt:
    """One object with what was planned and predicted for it.

    Attributes:
        object_id: Id of the object in its cloud.
        cloud: The object's points, unorganised.
        plan: Outcome of GeoGrasp.
        predictions: One for each grasp of the plan, in its order.
        ms: Time of `grasp` and `touch` [ms].
    """

    object_id: str
    cloud: Cloud
    plan: GraspPlan
    predictions: tuple[TouchPrediction, ...]
    ms: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class PipelineResult:
    """What one cloud gave.

    Attributes:
        status: "ok", or the status of the step that ended the road.
        reason: Why, in words; "" for "ok".
        segmentation: None where the cloud was an object already.
        plane: The table that grasps were planned on.
        felt: The target objects, best first.
        ms: Wall time a step and `total` [ms].
    """

    status: str
    reason: str
    segmentation: Segmentation | None
    plane: Plane | None
    felt: tuple[Felt, ...]
    ms: dict[str, float]


class Pipeline:
    """The road with its settings and its model, which is loaded when first needed.

    Raises:
        ModelError: By the first prediction, if the model cannot be loaded.
    """

    def __init__(self, config: PipelineConfig | None = None) -> None:
        self.config = config if config is not None else PipelineConfig()
        self._model: TouchModel | None = None

    @property
    def model(self) -> TouchModel:
        """The touch model, loaded once."""
        if self._model is None:
            self._model = load_model(self.config.model)
        return self._model

    def run(self, cloud: Cloud) -> PipelineResult:
        """From a cloud of the whole scene to predicted touch.

        Args:
            cloud: Organised (H, W, 3) or (N, 3), with the table in view.
        """
        began = time.perf_counter()
        segmentation = segment(cloud, self.config.segmentation)
        ms = {"segment": _ms_since(began)}
        if segmentation.status != "ok":
            return _ended(segmentation.status, segmentation.reason, segmentation, ms)
        targets, reason = choose_targets(segmentation.objects, self.config.target)
        if not targets:
            return _ended("no_target", reason, segmentation, ms)
        if segmentation.plane is None:
            raise AssertionError("a segmentation that is ok has a plane")
        shape = cloud.xyz.shape[:2] if cloud.organised else None
        felt = tuple(self._feel_object(target, segmentation.plane, shape) for target in targets)
        return _finished(segmentation, segmentation.plane, felt, ms)

    def run_object(self, cloud: Cloud, plane: Plane = ASSUMED_TABLE, *, object_id: str = "1") -> PipelineResult:
        """From a cloud that holds one object and nothing else to predicted touch.

        Args:
            cloud: The object's points.
            plane: The table it stands on, in the cloud's frame.
            object_id: Written into the grasps.
        """
        return _finished(None, plane, (self._feel(cloud, plane, object_id),), {})

    def plan(
        self,
        cloud: Cloud,
        plane: Plane,
        *,
        object_id: str = "",
        pixels: np.ndarray[tuple[int], np.dtype[np.int64]] | None = None,
        image_shape: tuple[int, int] | None = None,
    ) -> GraspPlan:
        """Grasps for one object (see `foretouch.grasp.plan_grasps`)."""
        seed = self.config.vary_seed
        rng = None if seed is None else np.random.default_rng([seed, cloud.stamp_ns])
        return plan_grasps(
            cloud, plane, self.config.grasp, rng=rng, pixels=pixels, image_shape=image_shape, object_id=object_id
        )

    def predict(self, cloud: Cloud, grasps: Sequence[Grasp], *, tare: Touch | None = None) -> list[TouchPrediction]:
        """Touch for each grasp on one object; the cloud's features are computed once."""
        return self.model.predict(cloud, grasps, tare=tare) if grasps else []

    def _feel_object(self, target: ObjectSegment, plane: Plane, shape: tuple[int, int] | None) -> Felt:
        pixels = target.pixels if shape is not None else None
        return self._feel(target.cloud, plane, str(target.id), pixels, shape)

    def _feel(
        self,
        cloud: Cloud,
        plane: Plane,
        object_id: str,
        pixels: np.ndarray[tuple[int], np.dtype[np.int64]] | None = None,
        shape: tuple[int, int] | None = None,
    ) -> Felt:
        began = time.perf_counter()
        plan = self.plan(cloud, plane, object_id=object_id, pixels=pixels, image_shape=shape)
        ms = {"grasp": _ms_since(began)}
        began = time.perf_counter()
        predictions = tuple(self.predict(cloud, plan.grasps))
        ms["touch"] = _ms_since(began)
        return Felt(object_id, cloud, plan, predictions, ms)


def _finished(segmentation: Segmentation | None, plane: Plane, felt: tuple[Felt, ...], ms: dict[str, float]) -> PipelineResult:
    for step in ("grasp", "touch"):
        ms[step] = sum(one.ms[step] for one in felt)
    ms["total"] = sum(ms.values())
    if any(one.predictions for one in felt):
        return PipelineResult("ok", "", segmentation, plane, felt, ms)
    return PipelineResult(felt[0].plan.status, felt[0].plan.reason, segmentation, plane, felt, ms)


def _ended(status: str, reason: str, segmentation: Segmentation, ms: dict[str, float]) -> PipelineResult:
    return PipelineResult(status, reason, segmentation, segmentation.plane, (), {**ms, "total": sum(ms.values())})


def _ms_since(began: float) -> float:
    return (time.perf_counter() - began) * 1e3
