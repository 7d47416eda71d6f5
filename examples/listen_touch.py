# SPDX-License-Identifier: Apache-2.0
"""Print every touch prediction: stamp, frame, grasp, and the predicted readings.

    python examples/listen_touch.py [--topic /foretouch/touch] [--count N]

Requires rclpy and the messages, but no other part of foretouch, like a program on another robot.
One array is published per cloud, empty with a reason if there is no prediction; both are printed.
"""

from __future__ import annotations

import argparse
import math
import os
import sys

# If rclpy was installed from PyPI, no setup file has been sourced.
os.environ.setdefault("AMENT_PREFIX_PATH", sys.prefix)

import rclpy
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy

from foretouch_msgs.msg import TouchPrediction, TouchPredictionArray

REFERENCES = {
    TouchPrediction.NONE: "the cloud only",
    TouchPrediction.TARE: "a tare",
    TouchPrediction.TOUCHES: "earlier touches",
    TouchPrediction.HISTORY: "earlier readings of the hand",
}


class TouchListener(Node):
    """Prints the arrays of one topic.

    Args:
        topic: Topic of type `foretouch_msgs/TouchPredictionArray`.
    """

    def __init__(self, topic: str) -> None:
        super().__init__("touch_listener")
        self.received = 0
        self.create_subscription(
            TouchPredictionArray, topic, self._print, QoSProfile(depth=100, reliability=ReliabilityPolicy.RELIABLE)
        )

    def _print(self, message: TouchPredictionArray) -> None:
        self.received += 1
        stamp = message.header.stamp
        start = f"{stamp.sec}.{stamp.nanosec:09d} {message.header.frame_id}"
        if not message.predictions:
            print(f"{start}: no prediction: {message.reason}", flush=True)
        for prediction in message.predictions:
            print(f"{start}: grasp {prediction.grasp.id}: {describe(prediction)}", flush=True)


def describe(prediction: object) -> str:
    """One line [counts]: pressures with half widths, mean and range of the electrodes, and the inputs used."""
    if prediction.reason:
        return prediction.reason
    words = []
    for finger, pressure, electrodes in (
        ("thumb", prediction.pdc_th, prediction.e_th),
        ("middle", prediction.pdc_mf, prediction.e_mf),
    ):
        values = [electrode.value for electrode in electrodes]
        mean = sum(values) / len(values)
        half = (pressure.upper - pressure.lower) / 2.0
        interval = "" if math.isnan(half) else f" ± {half:.0f}"
        words.append(
            f"{finger} PDC {pressure.value:.0f}{interval}, E {mean:.0f} ({min(values):.0f} to {max(values):.0f})"
        )
    return "; ".join([*words, f"based on {REFERENCES[prediction.reference]}", *prediction.flags])


def main() -> int:
    """Print until Ctrl-C, or until `--count` arrays have been received."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--topic", default="/foretouch/touch")
    parser.add_argument("--count", type=int, default=0, help="exit after this number of arrays; 0 never exits")
    arguments, others = parser.parse_known_args()
    rclpy.init(args=others)
    listener = TouchListener(arguments.topic)
    try:
        while not arguments.count or listener.received < arguments.count:
            rclpy.spin_once(listener)
    except KeyboardInterrupt:
        pass
    finally:
        listener.destroy_node()
        rclpy.try_shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(main())
