# SPDX-License-Identifier: Apache-2.0
"""Targets -> `grasps`: where two fingers can grasp each target."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

from geometry_msgs.msg import PoseArray
from std_msgs.msg import Header

from foretouch.cloud.geometry.limits import ObjectLimits
from foretouch.config import setting
from foretouch.grasp import CarriedConfig, GeoGraspConfig, GraspPlan, HandConfig
from foretouch.pipeline import Pipeline
from foretouch.ros.messages.conversions import grasp_to_msg
from foretouch.ros.messages.placement import Placement, poses_to_msg
from foretouch.ros.messages.requests import status_code
from foretouch.ros.runtime.lifecycle_node import ForetouchNode
from foretouch.ros.runtime.processing_node import Step, warm_up_cloud
from foretouch.ros.steps.frames import FrameSettings
from foretouch.stream import HoldConfig, Stream, StreamConfig
from foretouch.topics import GRASPS_TOPIC
from foretouch.types.scene import Object
from foretouch_msgs.msg import GraspArray


@dataclass(frozen=True, kw_only=True)
class GraspSettings(FrameSettings, HoldConfig):
    """Settings of the planner of grasps."""

    publish_grasp_poses: bool = setting(
        True, "Whether grasp_poses is offered: the poses of the tool as geometry_msgs/PoseArray", read_only=True
    )

    limits: ObjectLimits = ObjectLimits()
    grasp: GeoGraspConfig = GeoGraspConfig()
    hand: HandConfig = HandConfig()
    object: CarriedConfig = CarriedConfig()


def stream_config(config: Any) -> StreamConfig:
    """Return the settings of a stream from those of a node, which may hold a part of them."""
    names = [info.name for info in fields(StreamConfig) if hasattr(config, info.name)]
    return StreamConfig(**{name: getattr(config, name) for name in names})


class GraspStep(Step):
    """Plans grasps on each target (`Stream.plan`), and publishes them.

    Args:
        node: Publishes; it must be configuring, and its settings are `GraspSettings`.
        stream: Of the clouds.
    """

    def __init__(self, node: ForetouchNode[Any], stream: Stream) -> None:
        self._grasps = node.advertise(GraspArray, GRASPS_TOPIC, keep=True)
        self._poses = node.advertise(PoseArray, "grasp_poses") if node.config.publish_grasp_poses else None
        self._stream = stream
        for target in Pipeline().segment(warm_up_cloud()).targets:
            stream.pipeline.plan(target)

    def configure(self, config: GraspSettings) -> None:
        """Use other settings."""
        self._stream.configure(stream_config(config))

    def plan(self, targets: Sequence[Object], header: Header, note: str) -> tuple[GraspArray, Sequence[GraspPlan]]:
        """Plan grasps on all targets, and keep the best of the cloud before.

        Args:
            targets: At least one.
            header: Of their cloud.
            note: How they were selected.
        """
        plans = self._stream.plan(targets)
        return grasps_to_msg(targets, plans, header, note), plans

    def publish(self, message: GraspArray, placement: Placement) -> None:
        """Publish the grasps of one cloud.

        Args:
            message: The grasps, in the frame of the cloud.
            placement: Of their poses.
        """
        self._publish(message, placement)

    def refuse(self, header: Header, status: int, reason: str) -> None:
        """Publish that there is no grasp, and why; also where the grasps of this cloud could not be published."""
        self._publish(GraspArray(header=header, status=status, reason=reason), Placement(header))

    def _publish(self, message: GraspArray, placement: Placement) -> None:
        self._grasps.publish(message)
        if self._poses is not None and self._poses.get_subscription_count():
            self._poses.publish(poses_to_msg(message, placement))


def grasps_to_msg(targets: Sequence[Object], plans: Sequence[GraspPlan], header: Header, note: str = "") -> GraspArray:
    """Make the message of the grasps on all targets, in their order.

    Args:
        targets: At least one.
        plans: Of each target; the grasps have ids.
        header: Of their cloud.
        note: How the targets were selected, for the reason.

    Returns:
        The message. The status is OK if any target has a grasp, else the status of the first target. The reason names all
        targets without a grasp.
    """
    pairs = list(zip(targets, plans, strict=True))
    grasps = [grasp_to_msg(grasp, status_code(plan.status), plan.reason) for plan in plans for grasp in plan.grasps]
    reasons = [note] if note else []
    reasons += [f"object {t.id}: {p.reason}" if len(plans) > 1 else p.reason for t, p in pairs if p.status != "ok"]
    answered = [plan.status for plan in plans if plan.grasps]
    status = min(map(status_code, answered)) if answered else status_code(plans[0].status)
    return GraspArray(header=header, grasps=grasps, status=status, reason="; ".join(reasons))
