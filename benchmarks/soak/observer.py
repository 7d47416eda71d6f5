# SPDX-License-Identifier: Apache-2.0
"""Watches the graph from outside: stamps of every cloud on every topic, answers, diagnostics, state of the recorder."""

import math
import struct
import time
from collections import Counter
from collections.abc import Set as AbstractSet
from functools import partial
from typing import Any

from benchmarks.ros import SECOND, Client, Report, stamp_ns
from benchmarks.soak.accounting import STAGES, Drop

DOMAIN = 91
_STAMP = struct.Struct("<4xiI")  # of the header with which a serialised message begins
_SENDERS = {topic: node for node, topics in STAGES for topic in topics}


class Observer(Client):
    """A node in this process. Times are those of `time.monotonic` [s]."""

    def __init__(self) -> None:
        super().__init__("observer", DOMAIN)
        from sensor_msgs.msg import PointCloud2

        from foretouch.ros.runtime.subscription import Losses
        from foretouch.topics import TACTILE_TOPIC
        from foretouch_msgs.msg import BiotacAll, RecorderStatus, TouchPredictionArray

        self.clouds: dict[int, float] = {}  # first time of each stamp on `points`
        self.repeated = 0  # clouds with a stamp that was seen before
        self.stamps: dict[str, set[int]] = {name: set() for name in ("points", "touch")}
        self.answers: list[float] = []
        self.answered_at: dict[int, float] = {}  # first answer by stamp
        self.statuses: Counter[str] = Counter()
        self.not_finite = 0  # answers with a prediction that has status OK and a value that is not finite
        self.tactile_s = 0.0  # of the latest tactile message
        self.recorder: Any = None  # latest RecorderStatus
        self.drops: list[Drop] = []
        self._losses = {topic: Losses(partial(self._missed, topic)) for topic in self.stamps}
        self._seen_s = dict.fromkeys(self.stamps, time.monotonic())  # when each topic was last heard
        self.node.create_subscription(PointCloud2, "points", self._see_cloud, self.deep, raw=True)
        self.node.create_subscription(TouchPredictionArray, "touch", self._see_touch, self.deep)
        self.node.create_subscription(
            BiotacAll, TACTILE_TOPIC, lambda _: setattr(self, "tactile_s", time.monotonic()), self.deep, raw=True
        )
        self.node.create_subscription(
            RecorderStatus, "recorder_status", lambda message: setattr(self, "recorder", message), self.deep
        )
        self.serve()

    def processes(self, node: str) -> set[bytes]:
        """Return the processes of a node that have reported so far."""
        with self.lock:
            return {process for name, process in self.reports if name == node}

    def active(self, node: str, besides: AbstractSet[bytes]) -> bool:
        """Return whether a process of a node, besides these, has reported that it is active."""
        with self.lock:
            reports = [
                report for (name, process), report in self.reports.items() if name == node and process not in besides
            ]
        return any(report.values.get("state") == "active" for report in reports)

    def reported(self, node: str, before: Report | None, now: Report) -> None:
        """Note what was dropped since the report before."""
        counts = {key: key.removeprefix("dropped.") for key in now.values if key.startswith("dropped.")}
        counts["lost_on_the_way.points"] = "lost on the way"
        for key, reason in counts.items():
            more = int(now.values.get(key, 0)) - (int(before.values.get(key, 0)) if before else 0)
            if more > 0:
                self.drops.append(Drop(node, reason, more, before.time_s if before else now.time_s - 1.0, now.time_s))

    def _missed(self, topic: str, count: int) -> None:
        """Note messages that were sent but did not arrive here: a computer under load keeps this process waiting, too."""
        if node := _SENDERS.get(topic):
            reason = f"answered, not seen by the observer, {topic}"
            self.drops.append(Drop(node, reason, count, self._seen_s[topic] - 1.0, time.monotonic()))

    def _heard(self, topic: str, info: Any) -> None:
        self._losses[topic].arrived(info, publishers=1)
        self._seen_s[topic] = time.monotonic()

    def _see_cloud(self, data: bytes, info: Any) -> None:
        sec, nanosec = _STAMP.unpack_from(data)
        stamp, now = sec * SECOND + nanosec, time.monotonic()
        with self.lock:
            self._heard("points", info)
            self.repeated += stamp in self.clouds
            self.clouds.setdefault(stamp, now)
            self.stamps["points"].add(stamp)

    def _see_touch(self, message: Any, info: Any) -> None:
        from foretouch.ros.messages.requests import status_name

        stamp, now = stamp_ns(message.header.stamp), time.monotonic()
        good = [
            (*prediction.scalars, *prediction.values) for prediction in message.predictions if prediction.status == 0
        ]
        with self.lock:
            self._heard("touch", info)
            self.stamps["touch"].add(stamp)
            self.answers.append(now)
            self.answered_at.setdefault(stamp, now)
            self.statuses[status_name(message.status)] += 1
            self.not_finite += not all(math.isfinite(value) for values in good for value in values)
