# SPDX-License-Identifier: Apache-2.0
"""The pipeline from a cloud to predicted touch, shared by the nodes and the command line.

    scene cloud ─ segment ─► objects + table ─ plan ─► grasps ─ predict ─► touch

Each step is one method over the public function of its package, so that the same input gives
bit-equal output wherever it is run.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from foretouch.cloud.geometry.limits import ObjectLimits, check_object, check_table
from foretouch.cloud.segmentation.identity import ObjectIdentity
from foretouch.cloud.segmentation.masks import segment_mask
from foretouch.cloud.segmentation.objects import AMBIGUOUS_TARGET, TargetConfig, select_free, select_targets
from foretouch.cloud.segmentation.segment import Segmentation, SegmentationConfig, segment
from foretouch.cloud.timing import timed
from foretouch.config import Settings, setting
from foretouch.errors import CloudError, shown
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
from foretouch.models.touch_model import Snapshot
from foretouch.types import Cloud, Float64, Grasp, Grasps, Int32, Int64, Plane, Predictions, Touch

_ON_TABLE_M = 0.01  # from the plane of the table


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
class Object:
    """One object, and the table that it stands on."""

    id: str  # unique within its cloud
    cloud: Cloud  # (N, 3) [m], only the object's points, in the optical frame of the camera
    plane: Plane  # the table, in the cloud's frame
    pixels: Int64 | None = None  # (N,) int64, flat index of each point in the image that it comes from, if any
    image_shape: tuple[int, int] | None = None  # (H, W) of that image
    flags: tuple[str, ...] = ()  # of its predictions: `ambiguous_target` if other objects fit the rule as well
    obstacles: Obstacles | None = None  # all objects of the scene, if there are several

    @property
    def centroid(self) -> Float64:
        """(3,) float64 [m], mean of the points; NaN without any."""
        points = self.cloud.xyz.reshape(-1, 3).astype(np.float64)
        points = points[np.isfinite(points).all(axis=1)]
        return points.mean(axis=0) if len(points) else np.full(3, np.nan)


@dataclass(frozen=True, eq=False)
class Scene:
    """The table and the objects in a cloud."""

    status: str  # "ok", "no_target", or the status of the segmentation
    reason: str  # why, in words; for "ok" usually "", or how an ambiguous target was selected
    cloud: Cloud  # the whole cloud
    segmentation: Segmentation  # how table and objects were found, with its counts
    objects: tuple[Object, ...]  # all objects, nearest first, or in the order of the mask's labels
    targets: tuple[Object, ...]  # the objects to grasp, best first
    obstacles: Obstacles | None = None  # the points of all objects, if there are several

    @property
    def table(self) -> Plane | None:
        """The table, its normal towards the camera, in the cloud's frame; None if none was found."""
        return self.segmentation.plane

    @property
    def labels(self) -> Int32:
        """(H, W) int32, or (N,) of an unorganised cloud: the id of each point's object, 0 for none."""
        return self.segmentation.labels

    def at(self, u: int, v: int) -> Object:
        """Return the object at a pixel.

        Args:
            u: Column of the image, 0 at the left.
            v: Row of the image, 0 at the top.

        Raises:
            CloudError: If the pixel is outside the image, or no object is there; says what is. If it is not whole numbers.
        """
        if not all(isinstance(value, int | np.integer) for value in (u, v)):
            raise CloudError(f"pixel: ({shown(u)}, {shown(v)}) is not two whole numbers, column and row; round a click")
        depth = self.cloud.xyz[..., 2]
        if depth.ndim != 2:
            raise CloudError(f"pixel: a list of {depth.size} points has no pixels; select the object by a point")
        height, width = depth.shape
        if not (0 <= u < width and 0 <= v < height):
            raise CloudError(
                f"pixel: ({u}, {v}) is outside of the image, whose columns end at {width - 1}, rows at {height - 1}"
            )
        known = {object_.id: object_ for object_ in self.objects}
        if (name := str(self.labels[v, u])) in known:
            return known[name]
        xyz = self.cloud.xyz[v, u].astype(np.float64)
        where = "no object"
        if not np.isfinite(xyz).all():
            where = "a pixel without depth"
        elif self.table is not None and abs(self.table.height(xyz)) < _ON_TABLE_M:
            where = "the table"
        raise CloudError(f"pixel: ({u}, {v}) is {where}; the objects are {', '.join(known) or 'none'}")

    def near(self, point: npt.ArrayLike, tolerance_m: float = TargetConfig().tolerance_m) -> Object:
        """Return the object with the point that is nearest to a position.

        Args:
            point: (3,) [m], in the cloud's frame.
            tolerance_m: Largest distance of the nearest point [m].

        Raises:
            CloudError: If no object is so near, or the position is not finite.
        """
        position = np.asarray(point, np.float64)
        if position.shape != (3,) or not np.isfinite(position).all():
            raise CloudError(f"point: {position.tolist()} is not three finite numbers [m]")
        away = [
            float(np.linalg.norm(object_.cloud.xyz.astype(np.float64) - position, axis=1).min())
            for object_ in self.objects
        ]
        if not away or min(away) > tolerance_m:
            nearest = f"; the nearest is {min(away):.3f} m away" if away else ""
            at = ", ".join(f"{value:g}" for value in position.tolist())
            raise CloudError(f"point: no object within {tolerance_m:g} m of ({at}){nearest}")
        return self.objects[int(np.argmin(away))]


@dataclass(frozen=True, eq=False)
class TargetResult:
    """One object with its planned grasps and the predictions for them, in the same order."""

    target: Object
    plan: GraspPlan
    predictions: Predictions


@dataclass(frozen=True, eq=False)
class PipelineResult:
    """The result for one cloud."""

    status: str  # "ok", or the status of the step at which the pipeline ended
    reason: str  # why, in words; "" for "ok"
    scene: Scene | None  # none where the cloud holds only an object
    targets: tuple[TargetResult, ...]  # the objects to grasp with their predictions, best first
    ms: dict[str, float]  # wall time of the steps `segment`, `grasp`, `touch` that ran, and `total` [ms]


def _require_cloud(cloud: object) -> None:
    if not isinstance(cloud, Cloud):
        raise CloudError(
            f"cloud: {type(cloud).__name__} is not a Cloud, such as Cloud.from_depth(depth, K) or Cloud(xyz)"
        )


class Pipeline:
    """Runs the steps from a cloud to predicted touch.

    Args:
        config: Settings of all steps; the defaults if None. The touch model is loaded when it is first needed.
    """

    def __init__(self, config: PipelineConfig | None = None) -> None:
        self.config = config if config is not None else PipelineConfig()
        self._model: TouchModel | None = None

    @property
    def model(self) -> TouchModel:
        """The touch model, loaded once; a `ForetouchError` if it is absent or damaged."""
        if self._model is None:
            self._model = load_model(self.config.model)
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
        _require_cloud(cloud)
        if mask is not None:
            segmentation = segment_mask(cloud, mask, self.config.segmentation)
        else:
            segmentation = segment(cloud, self.config.segmentation)
            segmentation = segmentation if identity is None else identity.keep(segmentation)
        if segmentation.status != "ok" or segmentation.plane is None:
            return Scene(segmentation.status, segmentation.reason, cloud, segmentation, (), ())
        plane = segmentation.plane
        shape = (segmentation.labels.shape[0], segmentation.labels.shape[1]) if cloud.organised else None
        solid = [part for part in segmentation.background if part.background != "floating"]
        obstacles = Obstacles.of([(object_.id, object_.cloud.xyz) for object_ in (*segmentation.objects, *solid)])
        objects = {
            object_.id: Object(
                str(object_.id), object_.cloud, plane, object_.pixels if shape else None, shape, (), obstacles
            )
            for object_ in segmentation.objects
        }
        rule = self.config.target
        if rule.mode == "free" and segmentation.objects:
            chosen, reason = select_free(
                segmentation.objects, rule, lambda target: self._loss(objects[target.id]), previous
            )
        else:
            chosen, reason = select_targets(segmentation.objects, rule, previous)
        flags = (AMBIGUOUS_TARGET,) if reason.startswith(AMBIGUOUS_TARGET) else ()
        targets = tuple(replace(objects[part.id], flags=flags) for part in chosen)
        status = "ok" if targets else "no_target"
        return Scene(
            status, reason or segmentation.reason, cloud, segmentation, tuple(objects.values()), targets, obstacles
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
        return replace(plan, grasps=plan.grasps.replace(object_id=target.id))

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
        posed = Grasp(g1, g2, np.eye(3), object_id=target.id)
        check_object(target.cloud.xyz, self.config.limits)
        check_table(target.plane, self.config.limits)
        check_reach(posed, target.cloud.xyz, self.config.reach.max_width_m, self.config.reach.max_distance_m)
        axis, _ = object_axis(target.cloud, target.plane, self.config.grasp)
        return Grasp(g1, g2, hand_rotation(posed.g1, posed.g2, axis), object_id=target.id)

    def predict(
        self, target: Object, grasps: Sequence[Grasp], *, tare: Touch | None = None, history: Snapshot | None = None
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
        model = self.model
        if not grasps:
            return Predictions.refused(Grasps.of(grasps), model.sensor.channels, "refused", "")
        predictions = model.predict(
            target, grasps, tare=tare, history=history, limits=self.config.limits, reach=self.config.reach
        )
        for flag in target.flags:
            predictions = predictions.flagged(flag)
        return predictions

    def run(self, cloud: Cloud, plane: Plane | None = None, *, mask: npt.ArrayLike | None = None) -> PipelineResult:
        """Run all steps, from a cloud to predicted touch.

        Args:
            cloud: Of the whole scene, or of one object if the table is given.
            plane: The table, in the cloud's frame.
            mask: Labels of the objects, as in `segment`.

        Raises:
            CloudError: If the cloud or the table is of another type; for a mask as `segment`.
        """
        _require_cloud(cloud)
        if plane is not None and not isinstance(plane, Plane):
            raise CloudError(
                f"plane: {type(plane).__name__} is not a Plane, such as Plane.from_coefficients((a, b, c, d))"
            )
        ms: dict[str, float] = {}
        scene: Scene | None = None
        results: list[TargetResult] = []
        targets: tuple[Object, ...]
        if plane is not None:
            targets = (Object("1", cloud, plane),)
        else:
            with timed(ms, "segment"):
                scene = self.segment(cloud, mask=mask)
            targets = scene.targets
        for target in targets:
            with timed(ms, "grasp"):
                plan = self.plan(target)
            with timed(ms, "touch"):
                results.append(TargetResult(target, plan, self.predict(target, plan.grasps)))
        ms["total"] = sum(ms.values())
        status, reason = ("no_target", "") if scene is None else (scene.status, scene.reason)
        if results:
            ok, first = any(result.predictions for result in results), results[0].plan
            status, reason = ("ok", "") if ok else (first.status, first.reason)
        return PipelineResult(status, reason, scene, tuple(results), ms)
