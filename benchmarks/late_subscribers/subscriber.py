# SPDX-License-Identifier: Apache-2.0
"""A plain rclpy subscriber of predicted touch, as a planner has one: volatile and transient local at once.

Uses nothing of foretouch but its messages, and Fast DDS as it comes. Prints a JSON object a line when it is matched, for
each answer, and for a change of the state of the replay. Times are those of the wall clock [ns].
"""

from __future__ import annotations

import json
import os
import sys
import time
from contextlib import suppress
from typing import Any

os.environ.setdefault("AMENT_PREFIX_PATH", sys.prefix)

import rclpy
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from foretouch_msgs.msg import TouchPredictionArray

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class Subscriber(Node):
    """Prints stamp and time of publication of each answer."""

    def __init__(self) -> None:
        super().__init__(f"late_{os.getpid()}", namespace="/foretouch")
        for name, durability in (
            ("volatile", DurabilityPolicy.VOLATILE),
            ("transient local", DurabilityPolicy.TRANSIENT_LOCAL),
        ):
            self.create_subscription(
                TouchPredictionArray,
                "touch",
                lambda message, info, name=name: self._answered(name, message, info),
                QoSProfile(depth=100, reliability=ReliabilityPolicy.RELIABLE, durability=durability),
                event_callbacks=SubscriptionEventCallbacks(
                    matched=lambda event, name=name: event.current_count and say(matched=name, at=time.time_ns()),
                    incompatible_qos=lambda _: None,
                    use_default_callbacks=False,
                ),
            )
        self.create_subscription(DiagnosticStatus, "replay_status", self._replay, LATCHED)

    def _answered(self, name: str, message: TouchPredictionArray, info: Any) -> None:
        stamp = message.header.stamp
        say(
            answer=name,
            stamp=stamp.sec * 10**9 + stamp.nanosec,
            at=info["source_timestamp"],
            arrived=info["received_timestamp"],
        )

    def _replay(self, message: DiagnosticStatus, info: Any) -> None:
        say(replay=message.message, at=info["source_timestamp"])


def say(**values: Any) -> None:
    print(json.dumps(values), flush=True)


def main() -> None:
    rclpy.init(args=[])
    with suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(Subscriber())


if __name__ == "__main__":
    main()
