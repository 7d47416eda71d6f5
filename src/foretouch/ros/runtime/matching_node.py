# SPDX-License-Identifier: Apache-2.0
"""Nodes whose input is two messages of one cloud: for who replaces one step by a node of another package.

Messages are matched by their exact stamp: every output keeps the stamp of its cloud, so no tolerance is needed. A cloud that waits
too long for its partner is answered with FAILED and counted as dropped, `no_grasps` where these are missing; while that lasts, it
is an error in /diagnostics.
"""

import math
import threading
import time
from collections import Counter
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar, Final, TypeVar

from foretouch.config import setting
from foretouch.ros.runtime.diagnostics import Report
from foretouch.ros.runtime.discovery import publishers_of
from foretouch.ros.runtime.processing_node import Input, ProcessingConfig, ProcessingNode
from foretouch.ros.runtime.subscription import InputTopic
from foretouch.types import stamp_ns
from foretouch_msgs.msg import Status

_P = TypeVar("_P", bound="MatchingConfig")
_INCOMPLETE: Final = 64  # clouds that may wait for their partner


@dataclass(frozen=True, kw_only=True)
class MatchingConfig(ProcessingConfig):
    """Settings of a node that matches messages."""

    partner_timeout_s: float = setting(
        3.0,
        "Longest wait of a cloud for what belongs to it, such as its grasps, until it is answered without",
        bounds=(0.1, 3600.0),
    )


class MatchingNode(ProcessingNode[_P]):
    """Matches two messages by stamp and answers each pair, the newest next; the answer gets the header of the first."""

    inputs: ClassVar[tuple[InputTopic, InputTopic]]

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self._first, self._second = (topic.name for topic in self.inputs)
        self._lock = threading.Lock()
        self._incomplete: dict[int, Input] = {}  # by stamp; their content are messages by topic
        self._given_up: dict[int, str] = {}  # the topic that was missing, by stamp
        self._lacking: Counter[str] = Counter()  # clouds that were given up since the last pair, by missing topic
        self._lacking_s = (0.0, 0.0)  # when the first and the last of them were given up, `time.monotonic` [s]

    def _setup(self) -> None:
        for topic in self.inputs:
            self.subscribe(topic, partial(self._match, topic.name))

    def _stop(self) -> None:
        super()._stop()
        with self._lock:
            while self._incomplete:
                self._incomplete.popitem()
                self.statistics.drop("stopped")

    def diagnose(self, report: Report) -> None:
        """Add what all clouds lack for longer than `silence_s`, and who publishes it."""
        super().diagnose(report)
        (first_s, last_s), limit_s = self._lacking_s, self.config.silence_s
        if not self._lacking or last_s - first_s < limit_s or time.monotonic() - last_s > limit_s:
            return
        counts = ", ".join(
            f"{count} clouds without {topic} (published by {', '.join(publishers_of(self, topic)) or 'no node'})"
            for topic, count in dict(self._lacking).items()
        )
        report.errors.append(f"no complete input for {last_s - first_s:.0f} s: {counts}")

    def _match(self, topic: str, message: Any) -> None:
        """Complete the pair of a stamp, or let the message wait for its partner."""
        stamp = stamp_ns(message.header.stamp)
        with self._lock:
            item = self._incomplete.pop(stamp, None)
            if item is None and self._given_up.get(stamp) == topic:
                del self._given_up[stamp]  # it was answered without
                return
            if item is not None and topic in item.content:
                self.statistics.drop("repeated_stamp")
                item = None
            if item is None:
                item = Input(message.header, {}, self.statistics.receive())
            item.content[topic] = message
            complete = len(item.content) == len(self.inputs)
            if not complete:
                self._incomplete[stamp] = item
        if complete:
            self._lacking.clear()
            self._worker.put(item._replace(header=item.content[self._first].header))
        elif len(self._incomplete) > _INCOMPLETE:
            self._give_up(-math.inf)

    def _look(self) -> None:
        super()._look()
        self._give_up(time.monotonic() - self.config.partner_timeout_s)

    def _give_up(self, before_s: float) -> None:
        """Refuse the clouds without a partner that arrived before a time, by `time.monotonic` [s], and the oldest of too many.

        The worker does not do it: it is for clouds that can be answered.
        """
        with self._lock:
            excess = len(self._incomplete) - _INCOMPLETE
            overdue = {
                stamp: item
                for number, (stamp, item) in enumerate(self._incomplete.items())
                if number < excess or item.arrived < before_s
            }
            for stamp, item in overdue.items():
                del self._incomplete[stamp]
                self._given_up[stamp] = self._second if self._first in item.content else self._first
            while len(self._given_up) > _INCOMPLETE:
                del self._given_up[next(iter(self._given_up))]
        for item in overdue.values():
            if self.state_name != "active":
                self.statistics.drop("inactive")
                continue
            missing, now = self._second if self._first in item.content else self._first, time.monotonic()
            self._lacking_s = (self._lacking_s[0] if self._lacking else now, now)
            self._lacking[missing] += 1
            self.statistics.drop(f"no_{missing}")
            reason = f"no_{missing}: none came for this cloud; /diagnostics shows which node publishes them"
            self._refuse(item.header, Status.FAILED, reason)
            self._note(Status.FAILED, reason)
