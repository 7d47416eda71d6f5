# SPDX-License-Identifier: Apache-2.0
"""The action `sample_grasps`: plan on the given or the latest object, predict, and compute the costs."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeAlias

from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header

from foretouch.cloud.geometry.limits import ObjectLimits
from foretouch.pipeline import FoundObject, Pipeline, PipelineConfig
from foretouch.ros.messages import requests
from foretouch.ros.messages.clouds import TargetCloud
from foretouch.ros.messages.conversions import pose_stamped
from foretouch.ros.touch.costs import COSTS, SCORE, cost_of
from foretouch.tactile import TactileRanges
from foretouch_msgs.action import SampleGrasps
from foretouch_msgs.msg import Grasp, GraspArray, Status, TablePlane, TouchPrediction

Predict: TypeAlias = Callable[[FoundObject, Sequence[Grasp], Header], Sequence[TouchPrediction]]

_BATCH = 100  # grasps that are predicted between two looks for a cancel; predictions do not depend on it
_SUCCESS = "success"


class Latest(NamedTuple):
    """The newest object_cloud and the table of the same stamp."""

    cloud: PointCloud2 | TargetCloud
    table: TablePlane


@dataclass(frozen=True, eq=False)
class _Candidate:
    cost: float
    grasp: Grasp
    prediction: TouchPrediction


class GraspSampler:
    """Answers one goal; holds no state between goals.

    Args:
        predict: Gives the predictions for grasps on one target, in order.
        settings: Of GeoGrasp, with the limits of objects.
        ranges: Ranges of the tactile values, for costs of pressure.
        max_grasps: Maximum number of grasps that a goal may ask for.
        cost: Rule of goals that name none (see `cost_of`).
    """

    def __init__(
        self,
        predict: Predict,
        settings: PipelineConfig,
        ranges: TactileRanges,
        max_grasps: int,
        cost: str = SampleGrasps.Goal.PRESSURE,
    ) -> None:
        self._predict = predict
        self._settings = settings
        self._ranges = ranges
        self._max_grasps = max_grasps
        self._cost = cost

    def sample(
        self, goal: Any, latest: Latest | None, feedback: Callable[[Any], None], cancelled: Callable[[], bool]
    ) -> Any:
        """Plan, predict and sort.

        Args:
            goal: `SampleGrasps.Goal`.
            latest: The latest cloud of the graph, for a goal without a cloud.
            feedback: Called with a `SampleGrasps.Feedback` after each object, and after every 100 grasps.
            cancelled: Called before each object and after every 100 grasps; if true, the result holds the grasps that
                are predicted so far.

        Returns:
            `SampleGrasps.Result`, lowest cost first; grasps without a prediction are last, at infinite cost.

        Raises:
            RefusalError: If there is nothing to grasp, nothing can be predicted, or the goal is invalid.
        """
        cost = goal.cost or self._cost
        if cost not in COSTS:
            raise requests.RefusalError(Status.BAD_REQUEST, f"cost: {cost!r} is none of {', '.join(COSTS)}")
        if goal.count > self._max_grasps:
            raise requests.RefusalError(
                Status.BAD_REQUEST, f"count: {goal.count} is above max_grasps, {self._max_grasps}"
            )
        header, targets = _targets(goal, latest, self._settings.limits)
        grasp = self._settings.grasp
        config = grasp.replace(count=goal.count) if goal.count else grasp
        pipeline = Pipeline(self._settings.replace(grasp=config))
        candidates: list[_Candidate] = []
        plan = GraspArray()
        for target in targets:
            if cancelled():
                break
            plan = requests.plan_targets(pipeline, [target], header)
            for first in range(0, len(plan.grasps), _BATCH):
                if cancelled():
                    break
                fresh = self._rate(target, plan.grasps[first : first + _BATCH], header, cost)
                feedback(_feedback(fresh, header))
                candidates += fresh
        if cost != SCORE and candidates and all(math.isinf(c.cost) for c in candidates):
            raise requests.RefusalError(candidates[0].prediction.status, candidates[0].prediction.reason)
        if not candidates and cancelled():
            raise requests.RefusalError(Status.NO_GRASP, "cancelled before the first prediction")
        return _result(sorted(candidates, key=lambda c: c.cost), header, plan)

    def _rate(self, target: FoundObject, grasps: Sequence[Grasp], header: Header, cost: str) -> list[_Candidate]:
        predictions = self._predict(target, grasps, header)
        return [
            _Candidate(cost_of(cost, touch, self._ranges), grasp, touch)
            for grasp, touch in zip(grasps, predictions, strict=True)
        ]


def _targets(goal: Any, latest: Latest | None, limits: ObjectLimits) -> tuple[Header, tuple[FoundObject, ...]]:
    """The objects of a goal, and the header of their cloud."""
    if goal.cloud.width * goal.cloud.height:
        if not goal.table:
            raise requests.RefusalError(Status.BAD_PLANE, "table: is needed with a cloud")
        targets = requests.read_targets(goal.cloud, requests.read_plane(goal.table[0]))
        requests.check_optical(targets, limits)
        return goal.cloud.header, targets
    if latest is None:
        raise requests.RefusalError(
            Status.EMPTY_CLOUD, "cloud: is empty, and no object_cloud with a table was received yet"
        )
    header = latest.cloud.header
    return header, requests.read_targets(latest.cloud, requests.read_table(latest.table, header))


def _feedback(candidates: Sequence[_Candidate], header: Header) -> Any:
    return SampleGrasps.Feedback(
        grasp_candidates=[pose_stamped(c.grasp, header) for c in candidates],
        costs=[c.cost for c in candidates],
        grasps=[c.grasp for c in candidates],
    )


def _result(candidates: Sequence[_Candidate], header: Header, plan: GraspArray) -> Any:
    if not candidates:
        raise requests.RefusalError(plan.status, plan.reason)
    return SampleGrasps.Result(
        grasp_state=_SUCCESS,
        status=Status.OK,
        grasp_candidates=[pose_stamped(c.grasp, header) for c in candidates],
        costs=[c.cost for c in candidates],
        grasps=[c.grasp for c in candidates],
        predictions=[c.prediction for c in candidates],
    )


def failed(refusal: requests.RefusalError) -> Any:
    """The result of a goal that was refused."""
    return SampleGrasps.Result(grasp_state=f"{requests.status_name(refusal.status)}: {refusal}", status=refusal.status)
