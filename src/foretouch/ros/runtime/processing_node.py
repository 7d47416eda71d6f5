# SPDX-License-Identifier: Apache-2.0
"""The base class of nodes that answer every cloud: inputs of one stamp in, one answer out.

Messages of several topics that belong to one cloud are matched by their exact stamp: every output keeps the stamp
of its cloud, so no tolerance is needed. A cloud that waits too long for a message is answered with FAILED and counted as
dropped, `no_grasps` where these are missing; while that lasts, it is an error in /diagnostics.

Threads: callbacks only sort messages by stamp and queue them. A worker computes and publishes, in a thread that the nodes of
a process share, so that services, parameters, lifecycle and diagnostics respond meanwhile. The queue is bounded; where a node does not
keep up, it answers the newest cloud next. What is dropped is counted as `superseded`.
"""

import threading
import time
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, NamedTuple, TypeVar

import numpy as np
from std_msgs.msg import Header

from foretouch.config import setting
from foretouch.ros.messages.requests import RefusalError, status_name
from foretouch.ros.runtime.discovery import publishers_of
from foretouch.ros.runtime.lifecycle_node import ForetouchNode, NodeConfig
from foretouch.ros.runtime.workers import Worker
from foretouch.tactile.messages.table import stamp_ns
from foretouch.types import Cloud, Float32
from foretouch_msgs.msg import Status

_P = TypeVar("_P", bound="ProcessingConfig")


class _StampedSet(NamedTuple):
    """Messages by topic, all of one stamp, and the time of arrival of the first [s]."""

    messages: dict[str, Any]
    arrived: float


@dataclass(eq=False)
class StampSynchronizer:
    """Collects one message per topic for each stamp. Not thread-safe.

    A set that must be given up, since it waits too long or others need its place, is returned incomplete. What arrives for it
    afterwards is left out; a message of a topic that it had begins a new set.
    """

    topics: frozenset[str]  # of a set
    depth: int  # sets that may be incomplete at a time
    on_first: Callable[[], float]  # called at the first message of each set; gives its time of arrival
    on_drop: Callable[[str], None]  # called for each set dropped for a reason such as `repeated_stamp`
    _waiting: dict[int, _StampedSet] = field(default_factory=dict)
    _given_up: dict[int, frozenset[str]] = field(default_factory=dict)  # topics that they had, by stamp

    def add(self, topic: str, stamp_ns: int, message: Any) -> _StampedSet | None:
        """Add a message of a topic; returns the set of its stamp if that is now complete, or one that is given up."""
        found = self._waiting.get(stamp_ns)
        if found is None and topic not in self._given_up.pop(stamp_ns, (topic,)):
            return None
        if found is not None and topic in found.messages:
            del self._waiting[stamp_ns]
            self.on_drop("repeated_stamp")
            found = None
        if found is None:
            found = self._waiting[stamp_ns] = _StampedSet({}, self.on_first())
        found.messages[topic] = message
        if found.messages.keys() == self.topics:
            return self._waiting.pop(stamp_ns)
        return self._give_up() if len(self._waiting) > self.depth else None

    def overdue(self, before_s: float) -> "list[_StampedSet]":
        """Give up the sets that began before a time of arrival [s]."""
        count = sum(one.arrived < before_s for one in self._waiting.values())
        return [self._give_up() for _ in range(count)]

    def clear(self, reason: str) -> None:
        """Drop all incomplete sets."""
        while self._waiting:
            self._waiting.popitem()
            self.on_drop(reason)

    def _give_up(self) -> _StampedSet:
        stamp_ns, oldest = next(iter(self._waiting.items()))
        del self._waiting[stamp_ns]
        self._given_up[stamp_ns] = frozenset(oldest.messages)
        while len(self._given_up) > self.depth:
            del self._given_up[next(iter(self._given_up))]
        return oldest


@dataclass(frozen=True, kw_only=True)
class ProcessingConfig(NodeConfig):
    """Settings of every node that answers clouds."""

    queue_depth: int = setting(
        32,
        "Number of inputs that may wait; only the newest for 20 s once one has waited for 0.25 s, or some for 0.5 s without a pause",
        bounds=(1, 10_000),
        read_only=True,
    )
    silence_s: float = setting(5.0, "Longest time without an input before a warning", bounds=(0.1, 1e6))
    partner_timeout_s: float = setting(
        3.0,
        "Longest wait of a cloud for what belongs to it, such as its grasps, until it is answered without",
        bounds=(0.1, 3600.0),
    )


class ProcessingNode(ForetouchNode[_P], ABC):
    """Matches its inputs by stamp and answers each set, one at a time.

    `inputs` are message type and name of each topic of a set; the answer gets the header of the first.
    """

    def __init__(self, name: str, config_class: type[_P], inputs: Sequence[tuple[type, str]], **options: Any) -> None:
        super().__init__(name, config_class, **options)
        self._topics = tuple(inputs)
        self._lock = threading.Lock()
        self._synchronizer = StampSynchronizer(  # 64 are more than all queues upstream hold together
            frozenset(topic for _, topic in inputs), 64, self.statistics.receive, self.statistics.drop
        )
        self._worker: Worker[_StampedSet] = Worker(
            name,
            self.config.queue_depth,
            self.internal_errors.guarded(name, self._work, lambda *_: self.statistics.drop("failed")),
            lambda _, reason: self.statistics.drop(reason),
            self.direct_topics.thread(self.get_namespace()),
        )
        self._arrived = 0.0  # of the set that is being answered, `time.monotonic` [s]
        self._lacking: Counter[str] = Counter()  # sets that were given up since the last complete one, by missing topic
        self._lacking_s = (0.0, 0.0)  # when the first and the last of them were given up, `time.monotonic` [s]
        self._outcomes: Counter[str] = Counter()
        self._last_reason = ""
        self._silent_until = 0.0  # `time.monotonic` before which no refusal is logged [s]

    @abstractmethod
    def _answer(self, messages: dict[str, Any], header: Header) -> tuple[int, str]:
        """Convert the messages to arrays, compute, convert the result to messages and publish them.

        The messages, by topic, are of one stamp, and the header is that of the first topic. Returns the published status
        and its reason, or raises a `RefusalError` if there is no answer; `_refuse` is then called.
        """

    @abstractmethod
    def _refuse(self, header: Header, status: int, reason: str) -> None:
        """Publish empty outputs with a status and a reason."""

    def _setup(self) -> None:
        for message, topic in self._topics:
            self.subscribe(message, topic, partial(self._receive, topic))

    def _start(self) -> None:
        self._worker.start()

    def _stop(self) -> None:
        """Finish the current cloud and drop what waits."""
        self._worker.stop()
        with self._lock:
            self._synchronizer.clear("stopped")

    def errors(self) -> tuple[str, ...]:
        """What all clouds lack for longer than `silence_s`, and who publishes it."""
        (first_s, last_s), limit_s = self._lacking_s, self.config.silence_s
        if not self._lacking or last_s - first_s < limit_s or time.monotonic() - last_s > limit_s:
            return ()
        counts = ", ".join(
            f"{count} clouds without {topic} (published by {', '.join(publishers_of(self, topic)) or 'no node'})"
            for topic, count in dict(self._lacking).items()
        )
        return (f"no complete input for {last_s - first_s:.0f} s: {counts}",)

    def notes(self) -> dict[str, str]:
        """Numbers of answers by status, and why the last was empty."""
        return {
            **{f"answered.{name}": str(count) for name, count in sorted(self._outcomes.items())},
            "last_reason": self._last_reason,
        }

    def _receive(self, topic: str, message: Any) -> None:
        with self._lock:
            found = self._synchronizer.add(topic, stamp_ns(message.header.stamp), message)
        self._answer_in_turn([] if found is None else [found])

    def _look(self) -> None:
        super()._look()
        with self._lock:
            overdue = self._synchronizer.overdue(time.monotonic() - self.config.partner_timeout_s)
        self._answer_in_turn(overdue)

    def _answer_in_turn(self, jobs: Sequence[_StampedSet]) -> None:
        for job in jobs:
            if self.state_name != "active":
                self.statistics.drop("inactive")
            elif len(job.messages) < len(self._topics):
                self._answer_incomplete(job)
            else:
                self._worker.put(job)

    def _answer_incomplete(self, job: _StampedSet) -> None:
        """Refuse a cloud for which a message has not come; not by the worker, whose queue is for clouds that it can answer."""
        missing = next(topic for _, topic in self._topics if topic not in job.messages)
        now = time.monotonic()
        self._lacking_s = (self._lacking_s[0] if self._lacking else now, now)
        self._lacking[missing] += 1
        self.statistics.drop(f"no_{missing}")
        reason = f"no_{missing}: none came for this cloud; /diagnostics shows which node publishes them"
        self._refuse(next(iter(job.messages.values())).header, Status.FAILED, reason)
        self._note(Status.FAILED, reason)

    def _work(self, job: _StampedSet) -> None:
        self._arrived = job.arrived
        self._lacking.clear()
        header = job.messages[self._topics[0][1]].header
        age_s = self.age_s(stamp_ns(header.stamp))
        status, reason = self._answer_or_refuse(job.messages, header)
        self.statistics.use(job.arrived, age_s)
        self._note(status, reason)

    def _note(self, status: int, reason: str) -> None:
        """Count an answer, and log a refusal now and then."""
        self._outcomes[status_name(status)] += 1
        self._last_reason = reason
        if status not in (Status.OK, Status.INITIAL_POINTS) and time.monotonic() >= self._silent_until:
            self._silent_until = time.monotonic() + 5.0  # rclpy's own check takes 0.5 ms each time
            self.get_logger().warning(f"{status_name(status)}: {reason}")

    def _answer_or_refuse(self, messages: dict[str, Any], header: Header) -> tuple[int, str]:
        try:
            return self._answer(messages, header)
        except RefusalError as refusal:
            status, reason = refusal.status, refusal.reason
        except Exception as err:  # noqa: BLE001  a bug must not end the node, and must be reported
            status, reason = Status.FAILED, self.internal_errors.report(self.get_name(), err)
        self._refuse(header, status, reason)
        return status, reason


def warm_up_cloud() -> Cloud:
    """A grey box on a table, seen from above: (120, 160, 3) float32 [m], with colours for models that use them.

    It is processed while a node configures: else half a second of imports and first allocations would delay the first
    clouds, which then wait for each other.
    """
    row, column = np.mgrid[0:120, 0:160].astype(np.float32)
    depth = np.full((120, 160), 0.8, np.float32)
    depth[52:68, 60:100] = 0.7  # the top of the box, 7 x 17 cm
    ray_x, ray_y = (column - 80.0) / 160.0, (row - 60.0) / 160.0
    xyz: Float32 = np.stack([ray_x * depth, ray_y * depth, depth], axis=-1)
    return Cloud(xyz, np.full(xyz.shape, 128, np.uint8), frame_id="warm_up")
