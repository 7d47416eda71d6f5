# SPDX-License-Identifier: Apache-2.0
"""Print every touch prediction: stamp, frame, grasp, and the predicted readings.

    python examples/listen_touch.py [--topic /foretouch/touch] [--count N] [--max-age S]

Requires rclpy and the messages, but no other part of foretouch, like a program on another robot.
One array is published per cloud, empty with a reason if there is no prediction; both are printed.

It subscribes with transient local durability, and so gets the last ten answers when it joins late, with their own stamps.
A program that acts on predictions must discard old ones: `--max-age 0.5` on a live robot. By default all are printed,
because the stamps of a replayed recording are those of the recording.
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
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.time import Time

from foretouch import reading
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
        max_age_s: Answers with an older stamp are discarded [s].
    """

    def __init__(self, topic: str, max_age_s: float = math.inf) -> None:
        super().__init__("touch_listener")
        self.received = 0
        self.discarded = 0
        self._max_age_s = max_age_s
        profile = QoSProfile(
            depth=100, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL
        )
        self.create_subscription(TouchPredictionArray, topic, self._receive, profile)

    def _receive(self, message: TouchPredictionArray) -> None:
        age_s = (self.get_clock().now() - Time.from_msg(message.header.stamp)).nanoseconds * 1e-9
        if age_s > self._max_age_s:
            self.discarded += 1
            return
        self.received += 1
        self._print(message)

    def _print(self, message: TouchPredictionArray) -> None:
        stamp = message.header.stamp
        start = f"{stamp.sec}.{stamp.nanosec:09d} {message.header.frame_id}"
        if not message.predictions:
            print(f"{start}: no prediction: {message.reason}", flush=True)
        for prediction in message.predictions:
            print(f"{start}: grasp {prediction.grasp.id}:\n  {describe(prediction)}", flush=True)


def describe(prediction: object) -> str:
    """Lines for a finger each: mean, range and half width of each channel; then the inputs used."""
    if prediction.reason:
        return prediction.reason
    words = []
    predicted = reading(prediction)  # by channel, such as PDC (fingers,) and E (fingers, 24) of a BioTac SP
    for finger, name in enumerate(prediction.fingers):
        parts = []
        for channel in (*prediction.scalar_channels, *prediction.channels):
            values = predicted[channel]
            own = values.value[finger]
            half = (values.upper[finger] - values.lower[finger]).mean() / 2.0
            spread = f" ({own.min():.0f} to {own.max():.0f})" if own.size > 1 else ""
            parts.append(f"{channel} {own.mean():.0f}{spread}" + ("" if math.isnan(half) else f" ± {half:.0f}"))
        words.append(f"{name} {', '.join(parts)}")
    used = "; ".join([f"based on {REFERENCES[prediction.reference]}", *prediction.flags])
    return "\n  ".join([*words, used])


def main() -> int:
    """Print until Ctrl-C, or until `--count` arrays have been received."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--topic", default="/foretouch/touch")
    parser.add_argument("--count", type=int, default=0, help="exit after this number of arrays; 0 never exits")
    parser.add_argument(
        "--max-age", type=float, default=math.inf, metavar="S", help="discard answers with an older stamp [s]"
    )
    arguments, others = parser.parse_known_args()
    rclpy.init(args=others)
    listener = TouchListener(arguments.topic, arguments.max_age)
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
