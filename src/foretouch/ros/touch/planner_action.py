# SPDX-License-Identifier: Apache-2.0
"""The action `SampleGraspPoses` of MoveIt Task Constructor, where its package is installed.

Its goal is only a name, its result only a text; poses and costs come in the feedback. The stage that uses it
(`DeepGraspPose`) goes on with the first feedback and replaces earlier ones, so all grasps are sent in one message.
"""

import importlib
import math
from typing import Any

from rclpy.type_support import check_for_type_support

from foretouch.errors import ConfigError
from foretouch.ros.messages.requests import RefusalError, status_name
from foretouch_msgs.msg import Status

PLANNER_ACTION = "sample_grasp_poses"
"""Name of the action; one name cannot have two types."""


def planner_action_class(type_name: str) -> Any:
    """The class of an action such as `moveit_task_constructor_msgs/SampleGraspPoses`; None if it cannot be loaded.

    Raises:
        ConfigError: If the name is not of the form package/Type, or the type has no fields of this action.
    """
    package, _, name = type_name.partition("/")
    if not package.isidentifier() or not name.isidentifier():
        raise ConfigError(f"planner_action_type: {type_name!r} is not package/Type")
    try:
        kind = getattr(importlib.import_module(f"{package}.action"), name)
    except (ImportError, AttributeError):
        return None
    try:
        check_for_type_support(kind)
    except Exception:  # noqa: BLE001  of rosidl: a package whose libraries are not found must not end the node
        return None
    if not (hasattr(kind.Feedback(), "grasp_candidates") and hasattr(kind.Feedback(), "costs")):
        raise ConfigError(f"planner_action_type: {type_name} has no grasp_candidates and costs in its feedback")
    return kind


def planner_feedback(kind: Any, sampled: Any) -> Any:
    """All grasps of a `SampleGrasps.Result` that have a finite cost, lowest first; MoveIt takes others for failures.

    Raises:
        RefusalError: NO_GRASP, if no cost is finite.
    """
    pairs = zip(sampled.grasp_candidates, sampled.costs, strict=True)
    kept = [(pose, cost) for pose, cost in pairs if math.isfinite(cost)]
    if not kept:
        raise RefusalError(Status.NO_GRASP, "no grasp has a finite cost")
    return kind.Feedback(grasp_candidates=[pose for pose, _ in kept], costs=[cost for _, cost in kept])


def planner_result(kind: Any, refusal: RefusalError | None = None) -> Any:
    """The result of a goal that succeeded or was refused."""
    return kind.Result(grasp_state="success" if refusal is None else f"{status_name(refusal.status)}: {refusal}")
