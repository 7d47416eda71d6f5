# SPDX-License-Identifier: Apache-2.0
"""The actions `sample_grasps` and `sample_grasp_poses`: plan on the given or the latest object, predict, and compute the costs.

`sample_grasp_poses` is that of MoveIt Task Constructor, where its package is installed. Its goal is only a name, its
result only a text; poses and costs come in the feedback. The stage that uses it (`DeepGraspPose`) goes on with the first
feedback and replaces earlier ones, so all grasps are sent in one message.
"""

import importlib
import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from geometry_msgs.msg import Pose, PoseStamped
from rclpy.type_support import check_for_type_support
from std_msgs.msg import Header

from foretouch.errors import described
from foretouch.grasp.hand import tool_of
from foretouch.models.equal_pressure import EQUAL_PRESSURE, equal_groups
from foretouch.pipeline import Object, Pipeline, PipelineConfig
from foretouch.ros.messages import requests
from foretouch.ros.messages.requests import Latest, RefusalError, no_latest_cloud
from foretouch.ros.touch.config import COSTS, HARDER_FINGER, SCORE, TouchSettings
from foretouch.types import Float64
from foretouch_msgs.action import SampleGrasps
from foretouch_msgs.msg import Grasp, GraspArray, Status, TouchPrediction

PLANNER_ACTION = "sample_grasp_poses"
"""Name of the action; one name cannot have two types."""

PLANNER_TYPE = ("moveit_task_constructor_msgs", "SampleGraspPoses")
_PLANNER_COUNT = 20  # grasps in its answer, at most

Predicted: TypeAlias = tuple[TouchPrediction, Float64]
"""The prediction of a grasp, and (3, F) how hard each finger presses (`TaxelView.pressures`): values and bounds, NaN for none."""

Predict: TypeAlias = Callable[[Object, Sequence[Grasp], Header], Sequence[Predicted]]

_BATCH = 100  # grasps that are predicted between two looks for a cancel; predictions do not depend on it


class _Candidate(NamedTuple):
    cost: float
    half: float  # half width of the interval of the cost; NaN without one
    grasp: Grasp
    prediction: TouchPrediction


def sample_grasps(
    goal: Any,
    latest: Latest | None,
    config: TouchSettings,
    name: str,
    predict: Predict,
    feedback: Callable[[Any], None],
    cancelled: Callable[[], bool],
) -> Any:
    """Plan, predict and sort: a `SampleGrasps.Result`, lowest cost first; grasps without a prediction come last.

    Costs that differ by less than the half width of the interval of the lowest of them are equal; the best score is first then.
    A goal without a cloud is for the `latest` one; its `name` distinguishes its grasps from others on the same cloud. Before
    each object and after every 100 grasps, `feedback` is called with a `SampleGrasps.Feedback`, and if `cancelled` is then
    true, the result holds what is predicted so far. A `RefusalError` if there is nothing to grasp, nothing can be predicted,
    or the goal is invalid.
    """
    cost = goal.cost or config.sample_cost
    if cost not in COSTS:
        raise RefusalError(Status.BAD_REQUEST, f"cost: {cost!r} is not one of {', '.join(COSTS)}")
    if goal.count > config.max_grasps:
        raise RefusalError(Status.BAD_REQUEST, f"count: {goal.count} is above max_grasps, {config.max_grasps}")
    header, targets = _targets(goal, latest, config)
    planning = config.grasp.replace(count=goal.count) if goal.count else config.grasp
    pipeline = Pipeline(PipelineConfig(grasp=planning, hand=config.hand, limits=config.limits))
    candidates: list[_Candidate] = []
    plan = GraspArray()
    for target in targets:
        if cancelled():
            break
        plan, _ = requests.plan_targets(pipeline, [target], header)
        for grasp in plan.grasps:
            grasp.id += f"/{name}"
        for first in range(0, len(plan.grasps), _BATCH):
            if cancelled():
                break
            grasps = plan.grasps[first : first + _BATCH]
            pairs = zip(grasps, predict(target, grasps, header), strict=True)
            fresh = [_candidate(cost, grasp, *predicted) for grasp, predicted in pairs]
            feedback(SampleGrasps.Feedback(**_fields(fresh, header)))
            candidates += fresh
    if cost != SCORE and candidates and all(math.isinf(c.cost) for c in candidates):
        raise RefusalError(candidates[0].prediction.status, candidates[0].prediction.reason)
    if not candidates:
        if cancelled():
            raise RefusalError(Status.NO_GRASP, "cancelled before the first prediction")
        raise RefusalError(plan.status, plan.reason)
    candidates = _levelled(candidates)
    return SampleGrasps.Result(
        grasp_state="success",
        status=Status.OK,
        predictions=[c.prediction for c in candidates],
        **_fields(candidates, header),
    )


def _candidate(rule: str, grasp: Grasp, touch: TouchPrediction, pressed: Float64) -> _Candidate:
    cost, lower, upper = (cost_of(rule, grasp, bound) for bound in pressed)
    return _Candidate(cost, abs(upper - lower) / 2.0, grasp, touch)


def _levelled(candidates: Sequence[_Candidate]) -> list[_Candidate]:
    """Candidates by group of equal costs, which get the lowest of their group, then by score; the first group is flagged."""
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


def _targets(goal: Any, latest: Latest | None, config: TouchSettings) -> tuple[Header, tuple[Object, ...]]:
    """The objects of a goal, and the header of their cloud."""
    if goal.cloud.width * goal.cloud.height:
        if not goal.table:
            raise RefusalError(Status.BAD_PLANE, "table: is needed with a cloud")
        return goal.cloud.header, requests.read_targets(goal.cloud, requests.read_plane(goal.table[0]), config.limits)
    if latest is None:
        raise no_latest_cloud()
    if latest.refusal is not None:
        raise latest.refusal
    return latest.header, latest.targets


def _fields(candidates: Sequence[_Candidate], header: Header) -> dict[str, Any]:
    """What results and feedback have in common."""
    return {
        "grasp_candidates": [PoseStamped(header=header, pose=_pose_for_arm(c.grasp)) for c in candidates],
        "costs": [c.cost for c in candidates],
        "grasps": [c.grasp for c in candidates],
    }


def _pose_for_arm(grasp: Grasp) -> Pose:
    """The pose of the tool frame of a described hand; without one, the pose by GeoGrasp."""
    return grasp.pose_of_hand if tool_of(grasp.hand) else grasp.pose


def refused_goal(refusal: RefusalError) -> Any:
    """The result of a goal that was refused."""
    return SampleGrasps.Result(grasp_state=f"{requests.status_name(refusal.status)}: {refusal}", status=refusal.status)


def cost_of(rule: str, grasp: Grasp, pressed: Float64) -> float:
    """The cost of a grasp by a rule and (F,) how hard each finger presses; infinity for what is not finite.

    Rules: `pressure`, the mean of how hard both fingers press (`TaxelView.pressures`); `harder_finger`, the larger of the two;
    `score`, the negative score of GeoGrasp.
    """
    cost = -grasp.score if rule == SCORE else float(np.max(pressed) if rule == HARDER_FINGER else np.mean(pressed))
    return cost if math.isfinite(cost) else math.inf


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


def planner_goal(request: Any, max_grasps: int) -> Any:
    """The `SampleGrasps.Goal` of a goal of the planner."""
    return SampleGrasps.Goal(action_name=request.action_name, count=min(_PLANNER_COUNT, max_grasps))


def planner_feedback(kind: Any, sampled: Any) -> Any:
    """The grasps of a `SampleGrasps.Result` with a finite cost, which MoveIt needs; or a `RefusalError`."""
    pairs = zip(sampled.grasp_candidates, sampled.costs, strict=True)
    kept = [(pose, cost) for pose, cost in pairs if math.isfinite(cost)]
    if not kept:
        raise RefusalError(Status.NO_GRASP, "no grasp has a finite cost")
    return kind.Feedback(grasp_candidates=[pose for pose, _ in kept], costs=[cost for _, cost in kept])


def planner_result(kind: Any, refusal: RefusalError | None = None) -> Any:
    """The result of a goal that succeeded or was refused."""
    return kind.Result(grasp_state="success" if refusal is None else refused_goal(refusal).grasp_state)
