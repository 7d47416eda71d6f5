# SPDX-License-Identifier: Apache-2.0
"""The action `sample_grasps`: plan on the given or the latest object, predict, and compute the costs."""

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, TypeAlias

from geometry_msgs.msg import PoseStamped
from std_msgs.msg import Header

from foretouch.pipeline import FoundObject, Pipeline, PipelineConfig
from foretouch.ros.messages import requests
from foretouch.ros.messages.requests import RefusalError
from foretouch.ros.touch.config import TouchPredictorConfig
from foretouch.ros.touch.costs import COSTS, SCORE, cost_of
from foretouch.ros.touch.framed_request import Latest, no_latest_cloud
from foretouch_msgs.action import SampleGrasps
from foretouch_msgs.msg import Grasp, GraspArray, Status, TouchPrediction

Predict: TypeAlias = Callable[[FoundObject, Sequence[Grasp], Header], Sequence[TouchPrediction]]

_BATCH = 100  # grasps that are predicted between two looks for a cancel; predictions do not depend on it


class _Candidate(NamedTuple):
    cost: float
    grasp: Grasp
    prediction: TouchPrediction


def sample_grasps(
    goal: Any,
    latest: Latest | None,
    config: TouchPredictorConfig,
    predict: Predict,
    feedback: Callable[[Any], None],
    cancelled: Callable[[], bool],
) -> Any:
    """Plan, predict and sort.

    Args:
        goal: `SampleGrasps.Goal`.
        latest: The latest cloud of the graph, for a goal without a cloud.
        config: Settings.
        predict: Gives the predictions for grasps on one target, in order.
        feedback: Called with a `SampleGrasps.Feedback` after each object, and after every 100 grasps.
        cancelled: Called before each object and after every 100 grasps; if true, the result holds the grasps that
            are predicted so far.

    Returns:
        `SampleGrasps.Result`, lowest cost first; grasps without a prediction are last, at infinite cost.

    Raises:
        RefusalError: If there is nothing to grasp, nothing can be predicted, or the goal is invalid.
    """
    cost = goal.cost or config.sample_cost
    if cost not in COSTS:
        raise RefusalError(Status.BAD_REQUEST, f"cost: {cost!r} is none of {', '.join(COSTS)}")
    if goal.count > config.max_grasps:
        raise RefusalError(Status.BAD_REQUEST, f"count: {goal.count} is above max_grasps, {config.max_grasps}")
    header, targets = _targets(goal, latest, config)
    planning = config.grasp.replace(count=goal.count) if goal.count else config.grasp
    pipeline = Pipeline(PipelineConfig(grasp=planning, limits=config.limits))
    candidates: list[_Candidate] = []
    plan = GraspArray()
    for target in targets:
        if cancelled():
            break
        plan = requests.plan_targets(pipeline, [target], header)
        for first in range(0, len(plan.grasps), _BATCH):
            if cancelled():
                break
            grasps = plan.grasps[first : first + _BATCH]
            pairs = zip(grasps, predict(target, grasps, header), strict=True)
            fresh = [_Candidate(cost_of(cost, touch, config.ranges), grasp, touch) for grasp, touch in pairs]
            feedback(SampleGrasps.Feedback(**_fields(fresh, header)))
            candidates += fresh
    if cost != SCORE and candidates and all(math.isinf(c.cost) for c in candidates):
        raise RefusalError(candidates[0].prediction.status, candidates[0].prediction.reason)
    if not candidates:
        cancel = (Status.NO_GRASP, "cancelled before the first prediction")
        raise RefusalError(*cancel if cancelled() else (plan.status, plan.reason))
    candidates.sort(key=lambda c: c.cost)
    predictions = [c.prediction for c in candidates]
    return SampleGrasps.Result(
        grasp_state="success", status=Status.OK, predictions=predictions, **_fields(candidates, header)
    )


def _targets(goal: Any, latest: Latest | None, config: TouchPredictorConfig) -> tuple[Header, tuple[FoundObject, ...]]:
    """The objects of a goal, and the header of their cloud."""
    if goal.cloud.width * goal.cloud.height:
        if not goal.table:
            raise RefusalError(Status.BAD_PLANE, "table: is needed with a cloud")
        return goal.cloud.header, requests.read_targets(goal.cloud, requests.read_plane(goal.table[0]), config.limits)
    if latest is None:
        raise no_latest_cloud()
    header = latest.cloud.header
    return header, requests.read_targets(latest.cloud, requests.read_table(latest.table, header), config.limits)


def _fields(candidates: Sequence[_Candidate], header: Header) -> dict[str, Any]:
    """What results and feedback have in common."""
    return {
        "grasp_candidates": [PoseStamped(header=header, pose=c.grasp.pose) for c in candidates],
        "costs": [c.cost for c in candidates],
        "grasps": [c.grasp for c in candidates],
    }


def refused_goal(refusal: RefusalError) -> Any:
    """The result of a goal that was refused."""
    state = f"{requests.status_name(refusal.status)}: {refusal}"
    return SampleGrasps.Result(grasp_state=state, status=refusal.status)
