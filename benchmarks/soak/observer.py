# SPDX-License-Identifier: Apache-2.0
"""Watches the graph from outside: stamps of every cloud on every topic, answers, diagnostics, state of the recorder."""

from __future__ import annotations

import math
import struct
import threading
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from accounting import Drop

_STAMP = struct.Struct("<4xiI")  # of the header with which a serialised message begins
_TOPICS = ("points", "object_cloud", "table", "grasps")
_CALL_S = 30.0


def header_stamp(data: bytes) -> int:
    """Stamp of a serialised little-endian message that begins with a header [ns]."""
    sec, nanosec = _STAMP.unpack_from(data)
    return int(sec) * 1_000_000_000 + int(nanosec)


@dataclass
class Report:
    """The latest diagnostics of one process of a node."""

    time_s: float
    level: int
    message: str
    values: dict[str, str]


@dataclass
class Observations:
    """All that was seen. Times are those of `time.monotonic` [s]."""

    clouds: dict[int, float] = field(default_factory=dict)  # first time of each stamp on `points`
    repeated: int = 0  # clouds with a stamp that was seen before
    stamps: dict[str, set[int]] = field(default_factory=lambda: {name: set() for name in (*_TOPICS, "touch")})
    answers: list[float] = field(default_factory=list)
    answered_at: dict[int, float] = field(default_factory=dict)  # first answer by stamp
    answered_again: int = 0
    statuses: Counter[str] = field(default_factory=Counter)
    not_finite: int = 0  # predictions with status OK and a value that is not finite
    tactile_s: float = 0.0  # of the latest tactile message
    recorder: Any = None  # latest RecorderStatus
    reports: dict[tuple[str, bytes], Report] = field(default_factory=dict)  # by node and publisher
    drops: list[Drop] = field(default_factory=list)
    warnings: list[tuple[float, str, str]] = field(default_factory=list)  # time, node, message


class Observer:
    """A node in this process, served by one thread."""

    def __init__(self, namespace: str) -> None:
        import rclpy
        from diagnostic_msgs.msg import DiagnosticArray
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.qos import QoSProfile, ReliabilityPolicy
        from sensor_msgs.msg import PointCloud2

        from foretouch.topics import TACTILE_TOPIC
        from foretouch_msgs.msg import BiotacAll, GraspArray, RecorderStatus, TablePlane, TouchPredictionArray

        rclpy.init()
        self.node = rclpy.create_node("observer", namespace=namespace)
        self.seen = Observations()
        self.lock = threading.Lock()
        deep = QoSProfile(depth=500, reliability=ReliabilityPolicy.RELIABLE)
        kinds = (PointCloud2, PointCloud2, TablePlane, GraspArray)
        for topic, kind in zip(_TOPICS, kinds, strict=True):
            self.node.create_subscription(kind, topic, partial(self._stamped, topic), deep, raw=True)
        self.node.create_subscription(TouchPredictionArray, "touch", self._touch, deep)
        self.node.create_subscription(BiotacAll, TACTILE_TOPIC, self._tactile, deep, raw=True)
        self.node.create_subscription(RecorderStatus, "recorder_status", self._recorder, deep)
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self._diagnose, deep)
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.node)
        threading.Thread(target=self._executor.spin, daemon=True).start()

    def call(self, kind: type, name: str, request: Any) -> Any:
        """The answer of a service of the graph; None if there is none in time."""
        client = self.node.create_client(kind, name)
        try:
            if not client.wait_for_service(_CALL_S):
                return None
            future = client.call_async(request)
            self.wait(future.done, _CALL_S)
            return future.result() if future.done() else None
        finally:
            self.node.destroy_client(client)

    def wait(self, condition: Callable[[], bool], timeout_s: float) -> bool:
        """Wait until a condition holds; False if it does not in time."""
        end = time.monotonic() + timeout_s
        while not condition():
            if time.monotonic() > end:
                return False
            time.sleep(0.01)
        return True

    def publishers(self, node: str) -> set[bytes]:
        """The processes of a node that have reported so far."""
        with self.lock:
            return {gid for name, gid in self.seen.reports if name == node}

    def active(self, node: str, besides: set[bytes]) -> bool:
        """Whether a process of a node, besides these, has reported that it is active."""
        with self.lock:
            reports = [r for (name, gid), r in self.seen.reports.items() if name == node and gid not in besides]
        return any(report.values.get("state") == "active" for report in reports)

    def _stamped(self, topic: str, data: bytes) -> None:
        stamp, now = header_stamp(data), time.monotonic()
        with self.lock:
            if topic == "points":
                self.seen.repeated += stamp in self.seen.clouds
                self.seen.clouds.setdefault(stamp, now)
            self.seen.stamps[topic].add(stamp)

    def _touch(self, message: Any) -> None:
        from foretouch.ros.messages.requests import status_name

        stamp = message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec
        values = [
            interval.value
            for one in message.predictions
            if one.status == 0
            for interval in (one.pdc_th, one.pdc_mf, *one.e_th, *one.e_mf)
        ]
        with self.lock:
            self.seen.stamps["touch"].add(stamp)
            now = time.monotonic()
            self.seen.answers.append(now)
            self.seen.answered_again += stamp in self.seen.answered_at
            self.seen.answered_at.setdefault(stamp, now)
            self.seen.statuses[status_name(message.status)] += 1
            self.seen.not_finite += not all(map(math.isfinite, values))

    def _tactile(self, _data: bytes) -> None:
        self.seen.tactile_s = time.monotonic()

    def _recorder(self, message: Any) -> None:
        self.seen.recorder = message

    def _diagnose(self, message: Any, info: Any) -> None:
        now, gid = time.monotonic(), bytes(info["publisher_gid"]["data"])
        with self.lock:
            for status in message.status:
                name = status.name.rpartition("/")[2]
                level = status.level[0] if isinstance(status.level, bytes) else int(status.level)
                report = Report(now, level, status.message, {pair.key: pair.value for pair in status.values})
                before = self.seen.reports.get((name, gid))
                self._add_drops(name, before, report)
                if level and (before is None or before.message != status.message):
                    self.seen.warnings.append((now, name, status.message))
                self.seen.reports[name, gid] = report

    def _add_drops(self, node: str, before: Report | None, now: Report) -> None:
        counts = {key.removeprefix("dropped."): int(n) for key, n in now.values.items() if key.startswith("dropped.")}
        keys = {f"dropped.{reason}": reason for reason in counts}
        counts |= {topic: int(now.values.get(f"lost_on_the_way.{topic}", 0)) for topic in _TOPICS}
        keys |= {f"lost_on_the_way.{topic}": topic for topic in _TOPICS}
        for key, reason in keys.items():
            more = counts[reason] - (int(before.values.get(key, 0)) if before else 0)
            if more > 0:
                start = before.time_s if before else now.time_s - 1.0
                text = f"lost on the way, {reason}" if reason in _TOPICS else reason
                self.seen.drops.append(Drop(node, text, more, start, now.time_s))
