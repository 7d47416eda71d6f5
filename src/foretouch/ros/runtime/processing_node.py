# SPDX-License-Identifier: Apache-2.0
"""The base class of nodes that answer every cloud: inputs of one stamp in, one answer out.

Messages of several topics that belong to one cloud are matched by their exact stamp: every output keeps the stamp
of its cloud, so no tolerance is needed. The number of clouds that wait for a message is bounded.

Threads: callbacks only sort messages by stamp and queue them. A worker, whose thread the nodes of a process share unless
`direct` is unset, computes and publishes, in the thread that took the messages or in its own (see `executor`), so that
services, parameters, lifecycle and diagnostics respond meanwhile. The queue is bounded and drops its oldest input,
counted as `superseded`.
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
    """Collects one message per topic for each stamp. Not thread-safe."""

    topics: frozenset[str]  # of a set
    depth: int  # sets that may be incomplete at a time
    on_first: Callable[[], float]  # called at the first message of each set; gives its time of arrival
    on_drop: Callable[[str], None]  # called for each dropped set: `unpaired` (replaced by newer ones), `repeated_stamp`
    _waiting: dict[int, _StampedSet] = field(default_factory=dict)

    def add(self, topic: str, stamp_ns: int, message: Any) -> _StampedSet | None:
        """Add a message of a topic; returns the set of its stamp if that is now complete."""
        found = self._waiting.get(stamp_ns)
        if found is not None and topic in found.messages:
            del self._waiting[stamp_ns]
            self.on_drop("repeated_stamp")
            found = None
        if found is None:
            found = self._waiting[stamp_ns] = _StampedSet({}, self.on_first())
        found.messages[topic] = message
        if found.messages.keys() == self.topics:
            return self._waiting.pop(stamp_ns)
        if len(self._waiting) > self.depth:
            del self._waiting[next(iter(self._waiting))]
            self.on_drop("unpaired")
        return None

    def clear(self, reason: str) -> None:
        """Drop all incomplete sets."""
        while self._waiting:
            self._waiting.popitem()
            self.on_drop(reason)


@dataclass(frozen=True, kw_only=True)
class ProcessingConfig(NodeConfig):
    """Settings of every node that answers clouds."""

    queue_depth: int = setting(
        8, "Number of inputs that may wait; the oldest is dropped", minimum=1, maximum=10_000, read_only=True
    )
    silence_s: float = setting(
        5.0, "Longest time without an input before a warning", unit="s", minimum=0.1, maximum=1e6
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
            self.direct_topics.thread(self.get_namespace()) if self.is_direct else None,
        )
        self._arrived = 0.0  # of the set that is being answered, `time.monotonic` [s]
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

    def notes(self) -> dict[str, str]:
        """Numbers of answers by status, and why the last was empty."""
        return {
            **{f"answered.{name}": str(count) for name, count in sorted(self._outcomes.items())},
            "last_reason": self._last_reason,
        }

    def _receive(self, topic: str, message: Any) -> None:
        with self._lock:
            found = self._synchronizer.add(topic, stamp_ns(message.header.stamp), message)
        if found is None:
            return
        if self.state_name == "active":
            self._worker.put(found)
        else:
            self.statistics.drop("inactive")

    def _work(self, job: _StampedSet) -> None:
        self._arrived = job.arrived
        header = job.messages[self._topics[0][1]].header
        age_s = self.age_s(stamp_ns(header.stamp))
        status, reason = self._answer_or_refuse(job.messages, header)
        self.statistics.use(job.arrived, age_s)
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
    depth[45:75, 60:100] = 0.7  # the top of the box
    ray_x, ray_y = (column - 80.0) / 160.0, (row - 60.0) / 160.0
    xyz: Float32 = np.stack([ray_x * depth, ray_y * depth, depth], axis=-1)
    return Cloud(xyz, np.full(xyz.shape, 128, np.uint8), frame_id="warm_up")
