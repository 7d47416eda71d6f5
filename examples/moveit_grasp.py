# SPDX-License-Identifier: Apache-2.0
"""Take the best grasp with MoveIt: pre-grasp, grasp and lift as three pose goals of `move_group`, whose messages are all it needs.

Run it with the graph, its parameter `hand.name` set to your hand, a `move_group`, and the camera in the tree of tf2:
python examples/moveit_grasp.py. It moves the arm: first replace `plan_only=False` by True. Close and open your gripper where it says so.
"""

import numpy as np
import rclpy
from geometry_msgs.msg import Point, Pose, PoseStamped
from moveit_msgs.action import MoveGroup
from moveit_msgs.msg import (
    BoundingVolume,
    Constraints,
    MotionPlanRequest,
    MoveItErrorCodes,
    OrientationConstraint,
    PlanningOptions,
    PositionConstraint,
)
from rclpy.action import ActionClient
from rclpy.node import Node
from rclpy.wait_for_message import wait_for_message
from shape_msgs.msg import SolidPrimitive

from foretouch_msgs.action import SampleGrasps
from foretouch_msgs.msg import Grasp, TablePlane

GROUP, LINK = "panda_arm", "panda_hand_tcp"  # of your robot: the arm, and the tool frame of the description of the hand
BACK_M, LIFT_M = 0.1, 0.15
POSITION_M, TURN_RAD, TIMEOUT_S = 0.002, 0.02, 60.0


def moved(pose: Pose, direction: np.ndarray, distance_m: float) -> Pose:
    """A pose, moved along a direction of its frame."""
    p, (x, y, z) = pose.position, distance_m * direction
    return Pose(position=Point(x=p.x + x, y=p.y + y, z=p.z + z), orientation=pose.orientation)


def poses_of(grasp: Grasp, up: np.ndarray) -> tuple[Pose, Pose, Pose]:
    """Pre-grasp, grasp and lift of the tool frame, in the frame of the camera; `up` is the normal of the table."""
    approach = np.array([grasp.approach.x, grasp.approach.y, grasp.approach.z])
    at = grasp.pose_of_hand
    return moved(at, approach, -BACK_M), at, moved(at, up, LIFT_M)


def goal_of(pose: PoseStamped, *, plan_only: bool = False) -> MoveGroup.Goal:
    """The goal of `move_action` that brings LINK to a pose."""
    ball = SolidPrimitive(type=SolidPrimitive.SPHERE, dimensions=[POSITION_M])
    region = BoundingVolume(primitives=[ball], primitive_poses=[Pose(position=pose.pose.position)])
    place = PositionConstraint(header=pose.header, link_name=LINK, constraint_region=region, weight=1.0)
    limits = dict.fromkeys((f"absolute_{axis}_axis_tolerance" for axis in "xyz"), TURN_RAD)
    turn = OrientationConstraint(header=pose.header, link_name=LINK, orientation=pose.pose.orientation, weight=1.0, **limits)  # fmt: skip
    wanted = Constraints(position_constraints=[place], orientation_constraints=[turn])
    request = MotionPlanRequest(group_name=GROUP, goal_constraints=[wanted], num_planning_attempts=5, allowed_planning_time=5.0, max_velocity_scaling_factor=0.1, max_acceleration_scaling_factor=0.1)  # fmt: skip
    return MoveGroup.Goal(request=request, planning_options=PlanningOptions(plan_only=plan_only))


def result_of(node: Node, kind: type, name: str, goal: object) -> object:
    """Send a goal, and wait for its result."""
    client = ActionClient(node, kind, name)
    if not client.wait_for_server(TIMEOUT_S):
        raise SystemExit(f"{name}: no server within {TIMEOUT_S:g} s")
    sent = client.send_goal_async(goal)
    rclpy.spin_until_future_complete(node, sent, timeout_sec=TIMEOUT_S)
    done = sent.result().get_result_async()
    rclpy.spin_until_future_complete(node, done, timeout_sec=TIMEOUT_S)
    return done.result().result


def main() -> None:
    """Sample grasps, and take the first."""
    rclpy.init()
    node = Node("moveit_grasp", namespace="/foretouch")
    received, table = wait_for_message(TablePlane, node, "table", time_to_wait=TIMEOUT_S)
    sampled = result_of(node, SampleGrasps, "sample_grasps", SampleGrasps.Goal(count=5, cost="score"))
    if not received or not sampled.grasps:
        raise SystemExit(f"no grasp: {sampled.grasp_state}")
    header = sampled.grasp_candidates[0].header
    open_mm = 1e3 * sampled.grasps[0].width_at_most_m
    opened = f"pre-grasp: open the gripper by {open_mm:.0f} mm or more"
    names = (opened, "grasp: close it until both fingers touch", "lift")
    for name, pose in zip(names, poses_of(sampled.grasps[0], np.array(table.plane.coef[:3])), strict=True):
        moved_to = result_of(node, MoveGroup, "/move_action", goal_of(PoseStamped(header=header, pose=pose)))
        if moved_to.error_code.val != MoveItErrorCodes.SUCCESS:
            raise SystemExit(f"{name}: MoveIt error {moved_to.error_code.val}")
        input(f"{name}, then press Enter ")
    rclpy.shutdown()


if __name__ == "__main__":
    main()
