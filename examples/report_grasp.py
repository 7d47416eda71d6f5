# SPDX-License-Identifier: Apache-2.0
"""A robot that reports the grasp it has executed, so that the next predictions adapt to what its fingertips read.

Run it with the graph, a camera and a hand that publishes its readings: python examples/report_grasp.py
It executes the best grasp of the newest answer. Here the operator moves the hand and presses Enter; replace `execute`.
"""

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from rclpy.time import Time
from rclpy.wait_for_message import wait_for_message

from foretouch_msgs.msg import ExecutedGrasp, Grasp, TouchPredictionArray

TIMEOUT_S = 20.0


def execute(node: Node, grasp: Grasp) -> list[Time]:
    """The times when the hand began to close, held the object, and began to open, on the clock of its readings."""
    g1, g2 = ((point.x, point.y, point.z) for point in (grasp.g1, grasp.g2))
    print("grasp at ({:.3f}, {:.3f}, {:.3f}) and ({:.3f}, {:.3f}, {:.3f}) m".format(*g1, *g2), flush=True)
    times = []
    for moment in ("begins to close", "holds the object", "begins to open"):
        try:
            input(f"press Enter when the hand {moment} ")
        except EOFError:
            raise SystemExit("\nno terminal to press Enter in: start this by hand, or replace `execute`") from None
        times.append(node.get_clock().now())
    return times


def answer(node: Node) -> TouchPredictionArray:
    """The next answer of the graph."""
    received, message = wait_for_message(TouchPredictionArray, node, "touch", time_to_wait=TIMEOUT_S)
    if not received:
        raise SystemExit(f"touch: no answer within {TIMEOUT_S} s; is the graph running?")
    return message


def main() -> None:
    """Execute a grasp, report it, and wait until the predictions use its readings."""
    rclpy.init()
    node = Node("report_grasp", namespace="/foretouch")
    reports = node.create_publisher(ExecutedGrasp, "executed_grasp", 10)
    refusals: list[str] = []  # "grasp ID: REASON", of each report of perception

    def diagnose(message: DiagnosticArray) -> None:
        pairs = [pair for status in message.status for pair in status.values]
        refusals.extend(pair.value for pair in pairs if pair.key == "touches.last_refusal")

    node.create_subscription(DiagnosticArray, "/diagnostics", diagnose, 10)
    planned = answer(node)
    if not planned.predictions:
        raise SystemExit(f"no grasp: {planned.reason}")
    grasp, before = planned.predictions[0].grasp, planned.predictions[0].touches
    start, contact, release = (time.to_msg() for time in execute(node, grasp))
    report = ExecutedGrasp(header=planned.header, grasp_id=grasp.id, achieved=grasp.pose, success=True)
    report.header.stamp = node.get_clock().now().to_msg()
    report.start, report.contact, report.release = start, contact, release
    reports.publish(report)
    print(f"reported grasp {grasp.id}", flush=True)
    end = node.get_clock().now() + rclpy.duration.Duration(seconds=TIMEOUT_S)
    while node.get_clock().now() < end:
        predictions = answer(node).predictions
        for _ in range(10):
            rclpy.spin_once(node, timeout_sec=0.0)
        for refusal in refusals:
            if refusal.startswith(f"grasp {grasp.id}: "):
                raise SystemExit(f"refused: {refusal}")
        if predictions and predictions[0].touches > before:
            print(f"the predictions are adapted to {predictions[0].touches} touches of this object")
            rclpy.shutdown()
            return
    raise SystemExit(f"not adapted within {TIMEOUT_S} s")


if __name__ == "__main__":
    main()
