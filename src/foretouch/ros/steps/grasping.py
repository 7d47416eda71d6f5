# SPDX-License-Identifier: Apache-2.0
"""Targets -> `grasps`: where two fingers can grasp each target."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

from geometry_msgs.msg import PoseArray
from std_msgs.msg import Header

from foretouch.cloud.geometry.limits import ObjectLimits
from foretouch.config import setting
from foretouch.grasp import GeoGraspConfig, GraspHold, GraspPlan, HandConfig
from foretouch.pipeline import Pipeline, PipelineConfig
from foretouch.ros.messages.conversions import grasp_to_msg
from foretouch.ros.messages.placement import Placement, poses_to_msg
from foretouch.ros.messages.requests import status_code
from foretouch.ros.runtime.lifecycle_node import ForetouchNode
from foretouch.ros.runtime.processing_node import Step, warm_up_cloud
from foretouch.ros.steps.frames import FrameSettings
from foretouch.topics import GRASPS_TOPIC
from foretouch.types import stamp_ns
from foretouch.types.scene import Object
from foretouch_msgs.msg import GraspArray

_HOLD_TOLERANCE_M: Final = 0.005
"""Change of position or size that makes it another object, whose grasp is not kept."""


@dataclass(frozen=True, kw_only=True)
class GraspSettings(FrameSettings):
    """Settings of the planner of grasps."""

    publish_grasp_poses: bool = setting(
        True, "Whether grasp_poses is offered: the poses of the tool as geometry_msgs/PoseArray", read_only=True
    )

    limits: ObjectLimits = ObjectLimits()
    grasp: GeoGraspConfig = GeoGraspConfig()
    hand: HandConfig = HandConfig()
    grasp_hold: float = setting(
        0.5,
        "The last grasp of an object is kept until another is better by this score on three clouds in a row; "
        "0 disables it, as grasp.method original",
        bounds=(0.0, 1000.0),
    )


class GraspStep(Step):
    """Plans grasps on each target (`Pipeline.plan`) in the clouds of one stream, and publishes them.

    Args:
        node: Publishes; it must be configuring, and its settings are `GraspSettings`.
    """

    def __init__(self, node: ForetouchNode[Any]) -> None:
        self._grasps = node.advertise(GraspArray, GRASPS_TOPIC, keep=True)
        self._poses = node.advertise(PoseArray, "grasp_poses") if node.config.publish_grasp_poses else None
        self.configure(node.config)
        for target in Pipeline().segment(warm_up_cloud()).targets:
            self._pipeline.plan(target)

    def configure(self, config: GraspSettings) -> None:
        """Use other settings, and forget the grasps that are kept."""
        self._margin = config.grasp_hold
        self._pipeline = Pipeline(PipelineConfig(grasp=config.grasp, hand=config.hand, limits=config.limits))
        holds = config.grasp_hold > 0.0 and config.grasp.method == "completed"
        self._held = GraspHold(_HOLD_TOLERANCE_M) if holds else None

    def plan(self, targets: Sequence[Object], header: Header, note: str) -> tuple[GraspArray, Sequence[GraspPlan]]:
        """Plan grasps on all targets, and keep the best of the cloud before.

        Args:
            targets: At least one.
            header: Of their cloud.
            note: How they were selected.
        """
        return plan_targets(self._pipeline, targets, header, note, self._held, self._margin)

    def publish(self, message: GraspArray, placement: Placement) -> None:
        """Publish the grasps of one cloud.

        Args:
            message: The grasps, in the frame of the cloud.
            placement: Of their poses.
        """
        self._grasps.publish(message)
        if self._poses is not None and self._poses.get_subscription_count():
            self._poses.publish(poses_to_msg(message, placement))

    def refuse(self, header: Header, status: int, reason: str) -> None:
        """Publish that there is no grasp, and why."""
        self.publish(GraspArray(header=header, status=status, reason=reason), Placement(header))


def plan_targets(
    pipeline: Pipeline,
    targets: Sequence[Object],
    header: Header,
    note: str = "",
    held: GraspHold | None = None,
    margin: float = 0.0,
) -> tuple[GraspArray, list[GraspPlan]]:
    """Plan grasps on all targets, in their order; each gets an id made of stamp, object and rank.

    Args:
        pipeline: Plans.
        targets: At least one.
        header: Of their cloud.
        note: How they were selected, for the reason.
        held: The best grasps of the previous cloud, which are kept and updated.
        margin: Score by which another grasp must be better than one that is kept.

    Returns:
        The message and the plans. The status is OK if any target has a grasp, else the status of the first target. The reason
        names all targets without a grasp.
    """
    plans = []
    for target in targets:
        plan = pipeline.plan(target, held=held.find(target.cloud) if held else None, hold=margin)
        plans.append((target, plan))
        if held is not None and plan.grasps:
            held.remember(target.cloud, (plan.grasps[0], plan.outdone))
    if held is not None:
        held.next_cloud()
    grasps = []
    for target, plan in plans:
        for rank, grasp in enumerate(plan.grasps):
            planned = grasp_to_msg(grasp, status_code(plan.status), plan.reason)
            planned.id = planned.id or f"{stamp_ns(header.stamp)}/{target.id}/{rank}"
            planned.object_id = target.id
            grasps.append(planned)
    reasons = [note] if note else []
    reasons += [f"object {t.id}: {p.reason}" if len(plans) > 1 else p.reason for t, p in plans if p.status != "ok"]
    answered = [plan.status for _, plan in plans if plan.grasps]
    status = min(map(status_code, answered)) if answered else status_code(plans[0][1].status)
    message = GraspArray(header=header, grasps=grasps, status=status, reason="; ".join(reasons))
    return message, [plan for _, plan in plans]
