# SPDX-License-Identifier: Apache-2.0
"""The answer to a goal of `sample_grasps`: plan on the given or the latest objects, predict, and order by cost.

The action of MoveIt Task Constructor has a goal that is only a name, and a result that is only a text; poses and costs come in the
feedback. The stage that uses it (`DeepGraspPose`) goes on with the first feedback and replaces earlier ones, so all grasps are sent
in one message.
"""

import importlib
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, Final, NamedTuple

import numpy as np
from geometry_msgs.msg import PoseStamped
from rclpy.type_support import check_for_type_support

from foretouch.errors import described
from foretouch.grasp import GraspPlan
from foretouch.models.equal_pressure import EQUAL_PRESSURE, equal_groups, predicted_pressures
from foretouch.pipeline import Pipeline, PipelineConfig
from foretouch.ros.messages.placement import Placement, tool_pose
from foretouch.ros.messages.requests import RefusalError, requested_targets
from foretouch.ros.steps.grasping import grasps_to_msg
from foretouch.ros.steps.touch import TouchStep
from foretouch.ros.steps.touch_settings import COSTS, HARDER_FINGER, SCORE, TouchSettings
from foretouch.stream import named
from foretouch.types import Float64
from foretouch.types.scene import Object
from foretouch_msgs.action import SampleGrasps
from foretouch_msgs.msg import Grasp, GraspArray, Status, TouchPrediction

PLANNER_ACTION: Final = "sample_grasp_poses"
"""Name of the action for MoveIt Task Constructor; one name cannot have two types."""

PLANNER_TYPE = ("moveit_task_constructor_msgs", "SampleGraspPoses")
PLANNER_COUNT: Final = 20
"""Grasps in the answer to a goal of MoveIt Task Constructor, at most."""

_BATCH: Final = 100  # grasps that are predicted between two looks for a cancel; predictions do not depend on it


class _Candidate(NamedTuple):
    cost: float
    half: float  # half width of the interval of the cost; NaN without one
    grasp: Grasp  # in the frame of the cloud
    prediction: TouchPrediction  # for it, and in the frame of the answer


def sample_grasps(
    step: TouchStep, config: TouchSettings, goal: Any, handle: Any, feedback: Callable[[Any], object]
) -> Any:
    """Plan, predict and order the grasps of a goal.

    Costs that differ by less than the half width of the interval of the lowest of them are equal; the best score is first then.
    Before each object and after every 100 grasps, a cancel ends the work.

    Args:
        step: Predicts, and has the newest objects, for a goal without a cloud.
        config: Settings.
        goal: A `SampleGrasps.Goal`.
        handle: The handle of the goal, which may be cancelled. Its id distinguishes the grasps from others on the same cloud.
        feedback: Called with a `SampleGrasps.Feedback` after every 100 grasps.

    Returns:
        A `SampleGrasps.Result`, lowest cost first. Grasps without a prediction come last.

    Raises:
        RefusalError: If there is nothing to grasp, nothing can be predicted, or the goal is invalid.
    """
    rule = goal.cost or config.sample_cost
    if rule not in COSTS:
        raise RefusalError(Status.BAD_REQUEST, f"cost: {rule!r} is not one of {', '.join(COSTS)}")
    if goal.count > config.max_grasps:
        raise RefusalError(Status.BAD_REQUEST, f"count: {goal.count} is above max_grasps, {config.max_grasps}")
    targets = requested_targets(goal, step.latest, config.limits, step.frames.placement)
    if targets.refusal is not None:  # the table of a given cloud is not known
        raise targets.refusal
    planning = config.grasp.replace(count=goal.count) if goal.count else config.grasp
    settings = PipelineConfig(grasp=planning, hand=config.hand, object=config.object, limits=config.limits)
    pipeline = Pipeline(settings)
    name = bytes(handle.goal_id.uuid).hex()[:8]
    candidates: list[_Candidate] = []
    message = GraspArray()
    for target in targets.objects:
        if handle.is_cancel_requested:
            break
        plan = named(pipeline.plan(target), target, name)
        message = grasps_to_msg([target], [plan], targets.header)
        for first in range(0, len(plan.grasps), _BATCH):
            if handle.is_cancel_requested:
                break
            part = slice(first, first + _BATCH)
            batch = GraspArray(header=targets.header, grasps=message.grasps[part])
            fresh = _predicted(step, rule, target, replace(plan, grasps=plan.grasps[part]), batch, targets.answered_in)
            feedback(SampleGrasps.Feedback(**_fields(fresh)))
            candidates += fresh
    if not candidates:
        if handle.is_cancel_requested:
            raise RefusalError(Status.NO_GRASP, "cancelled before the first prediction")
        raise RefusalError(message.status, message.reason)
    if rule != SCORE and all(math.isinf(candidate.cost) for candidate in candidates):
        raise RefusalError(candidates[0].prediction.status, candidates[0].prediction.reason)
    candidates, fields = _levelled(candidates), {"grasp_state": "success", "status": Status.OK}
    fields |= _fields(candidates)
    step.add_requested(targets, [candidate.grasp for candidate in candidates])
    return SampleGrasps.Result(predictions=[candidate.prediction for candidate in candidates], **fields)


def _predicted(
    step: TouchStep, rule: str, target: Object, plan: GraspPlan, message: GraspArray, placement: Placement
) -> list[_Candidate]:
    """Predict for planned grasps, whose message is given, and rate each by how hard the fingers press: value and bounds."""
    answer, model = step.answer_plans([target], [plan], message), step.predictor.model
    pressed = np.full((3, len(plan.grasps), 1), np.nan)
    if model is not None:
        pressed = predicted_pressures(answer.predictions, model)
    candidates = []
    for k, prediction in enumerate(answer.placed(placement).message.predictions):
        cost, lower, upper = (cost_of(rule, prediction.grasp, bound) for bound in pressed[:, k])
        candidates.append(_Candidate(cost, abs(upper - lower) / 2.0, message.grasps[k], prediction))
    return candidates


def cost_of(rule: str, grasp: Grasp, pressed: Float64) -> float:
    """Compute the cost of a grasp; infinity for what is not finite.

    Args:
        rule: `pressure`, the mean of how hard both fingers press (`TaxelView.pressures`); `harder_finger`, the larger of the two;
            `score`, the negative score of GeoGrasp.
        grasp: The grasp.
        pressed: (F,) how hard each finger presses.
    """
    if rule == SCORE:
        cost = -grasp.score
    elif rule == HARDER_FINGER:
        cost = float(np.max(pressed))
    else:
        cost = float(np.mean(pressed))
    return cost if math.isfinite(cost) else math.inf


def _levelled(candidates: Sequence[_Candidate]) -> list[_Candidate]:
    """Order candidates by group of equal costs, which get the lowest of their group, then by score; the first group is flagged."""
    groups = equal_groups([candidate.cost for candidate in candidates], [candidate.half for candidate in candidates])
    lowest = np.full(len(candidates), math.inf)
    np.minimum.at(lowest, groups, [candidate.cost for candidate in candidates])
    alike = np.count_nonzero(groups == 0) > 1
    for candidate, group in zip(candidates, groups, strict=True):  # flags were given in batches
        flags = [flag for flag in candidate.prediction.flags if flag != EQUAL_PRESSURE]
        if alike and group == 0:
            flags.append(EQUAL_PRESSURE)
        candidate.prediction.flags = flags
    scores = np.nan_to_num([candidate.grasp.score for candidate in candidates], nan=-math.inf)
    return [candidates[k]._replace(cost=float(lowest[groups[k]])) for k in np.lexsort((-scores, groups))]


def _fields(candidates: Sequence[_Candidate]) -> dict[str, Any]:
    """Make what results and feedback have in common."""
    predictions = [candidate.prediction for candidate in candidates]
    return {
        "grasp_candidates": [PoseStamped(header=one.header, pose=tool_pose(one.grasp)) for one in predictions],
        "costs": [candidate.cost for candidate in candidates],
        "grasps": [prediction.grasp for prediction in predictions],
    }


def planner_action_class() -> tuple[Any, str]:
    """Find the class of the action of MoveIt Task Constructor; None where its package is not installed, or cannot be used and why."""
    package, name = PLANNER_TYPE
    try:
        kind = getattr(importlib.import_module(f"{package}.action"), name)
        check_for_type_support(kind)
    except Exception as err:  # noqa: BLE001  also of rosidl: a package whose libraries are not found must not end the node
        absent = isinstance(err, ModuleNotFoundError) and (err.name or "").partition(".")[0] == package
        return None, "" if absent else f"{PLANNER_ACTION}: not offered: {package}/{name}: {described(err)}"
    return kind, ""


def planner_feedback(kind: Any, sampled: Any) -> Any:
    """Select the grasps with a finite cost, which MoveIt needs.

    Args:
        kind: Class of MoveIt's action.
        sampled: A `SampleGrasps.Result`.

    Raises:
        RefusalError: If no grasp has a finite cost.
    """
    pairs = zip(sampled.grasp_candidates, sampled.costs, strict=True)
    kept = [(pose, cost) for pose, cost in pairs if math.isfinite(cost)]
    if not kept:
        raise RefusalError(Status.NO_GRASP, "no grasp has a finite cost")
    return kind.Feedback(grasp_candidates=[pose for pose, _ in kept], costs=[cost for _, cost in kept])
