# SPDX-License-Identifier: Apache-2.0
"""A grasp that the simulated hand executes, from the order to the report. No node, no thread."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from geometry_msgs.msg import Pose, Quaternion

from foretouch.grasp import quaternion_xyzw
from foretouch.ros.conversions import header_to_msg, point_to_msg, stamp_to_msg
from foretouch.simulation.execution import Course
from foretouch_msgs.msg import ExecutedGrasp

__all__ = ["Execution", "Order", "executed_to_msg"]


@dataclass(frozen=True, eq=False)
class Order:
    """A grasp to execute.

    Attributes:
        message: `GraspArray`; its first grasp is meant.
        planned_ns: Stamp of the cloud that it was planned on [ns].
        arrived: When it was taken (`time.monotonic`) [s].
    """

    message: Any
    planned_ns: int
    arrived: float


@dataclass(frozen=True, eq=False)
class Execution:
    """A course under way.

    Attributes:
        order: What was asked for.
        course: What the hand does, a row a message.
        first: Number of the message that is row 0.
    """

    order: Order
    course: Course
    first: int = 0


def executed_to_msg(execution: Execution, first_ns: int, period_ns: int) -> ExecutedGrasp:
    """What was done.

    Args:
        execution: Of the grasp.
        first_ns: Stamp of the message that was row 0 [ns].
        period_ns: Between two messages [ns].
    """
    course, planned = execution.course, execution.order.message
    times = {
        name: stamp_to_msg(0 if row is None else first_ns + row * period_ns)
        for name, row in (("start", course.start), ("contact", course.contact), ("release", course.release))
    }
    x, y, z, w = map(float, quaternion_xyzw(course.rotation))
    achieved = Pose(position=point_to_msg(course.midpoint), orientation=Quaternion(x=x, y=y, z=z, w=w))
    header = header_to_msg(planned.header.frame_id, first_ns + len(course.counts) * period_ns)
    grasp_id = planned.grasps[0].id
    return ExecutedGrasp(header=header, grasp_id=grasp_id, achieved=achieved, success=course.success, **times)
