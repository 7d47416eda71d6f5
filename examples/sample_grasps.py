# SPDX-License-Identifier: Apache-2.0
"""A planner that lets foretouch generate the grasps: ask the action for ten, and print their poses, cheapest first.

Run it with the graph and a camera or a replay: python examples/sample_grasps.py
"""

import rclpy
from rclpy.action import ActionClient
from rclpy.node import Node

from foretouch_msgs.action import SampleGrasps

COUNT = 10
COST = "harder_finger"  # the pressure of the finger that is pressed harder, 0 lowest, 1 highest of its range
TIMEOUT_S = 20.0


def wait(node: Node, future: rclpy.Future) -> object:
    """The result of a future."""
    rclpy.spin_until_future_complete(node, future, timeout_sec=TIMEOUT_S)
    if not future.done():
        raise SystemExit(f"sample_grasps: no answer within {TIMEOUT_S} s")
    return future.result()


def main() -> None:
    """Sample grasps on the latest object."""
    rclpy.init()
    node = Node("sample_grasps_example", namespace="/foretouch")
    client = ActionClient(node, SampleGrasps, "sample_grasps")
    if not client.wait_for_server(TIMEOUT_S):
        raise SystemExit(f"sample_grasps: no server within {TIMEOUT_S} s; is the graph running?")
    handle = wait(node, client.send_goal_async(SampleGrasps.Goal(count=COUNT, cost=COST)))
    result = wait(node, handle.get_result_async()).result
    if not result.grasp_candidates:
        raise SystemExit(f"no grasp: {result.grasp_state}")
    print(f"{len(result.costs)} of {COUNT} grasps, in {result.grasp_candidates[0].header.frame_id}, cheapest first:")
    for pose, cost, prediction in zip(result.grasp_candidates, result.costs, result.predictions, strict=True):
        p = pose.pose.position
        print(f"cost {cost:.2f} at ({p.x:.3f}, {p.y:.3f}, {p.z:.3f}) m, flags {list(prediction.flags)}")
    rclpy.shutdown()


if __name__ == "__main__":
    main()
