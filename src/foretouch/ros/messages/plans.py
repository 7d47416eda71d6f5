# SPDX-License-Identifier: Apache-2.0
"""Grasp plans as messages, for the topic and the action alike."""

from __future__ import annotations

from collections.abc import Sequence

from std_msgs.msg import Header

from foretouch.grasp import GraspPlan
from foretouch.pipeline import FoundObject, Pipeline
from foretouch.ros.messages.conversions import grasp_to_msg, stamp_ns
from foretouch.ros.messages.status import status_code
from foretouch_msgs.msg import Grasp, GraspArray

__all__ = ["plan_targets"]


def plan_targets(pipeline: Pipeline, targets: Sequence[FoundObject], header: Header) -> GraspArray:
    """Grasps on all targets, those of the first target first.

    Args:
        pipeline: Its grasp settings are used.
        targets: At least one.
        header: Of the cloud.

    Returns:
        Status OK where any target has a grasp, else that of the first target; reasons of all that have none.
    """
    plans = [(target, pipeline.plan(target)) for target in targets]
    grasps = [grasp for target, plan in plans for grasp in _messages(plan, target.id, stamp_ns(header.stamp))]
    reasons = [f"object {t.id}: {p.reason}" if len(plans) > 1 else p.reason for t, p in plans if p.status != "ok"]
    answered = [plan.status for _, plan in plans if plan.grasps]
    status = min(map(status_code, answered)) if answered else status_code(plans[0][1].status)
    return GraspArray(header=header, grasps=grasps, status=status, reason="; ".join(reasons))


def _messages(plan: GraspPlan, object_id: str, nanoseconds: int) -> list[Grasp]:
    """The grasps of a plan, best first, each with an id made of stamp, object and rank.

    Args:
        plan: Of GeoGrasp.
        object_id: The object.
        nanoseconds: Stamp of its cloud [ns].
    """
    status = status_code(plan.status)
    messages = []
    for rank, grasp in enumerate(plan.grasps):
        message = grasp_to_msg(grasp, status, plan.reason)
        message.id = message.id or f"{nanoseconds}/{object_id}/{rank}"
        message.object_id = object_id
        messages.append(message)
    return messages
