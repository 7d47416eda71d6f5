# SPDX-License-Identifier: Apache-2.0
"""Messages of several topics that belong to one cloud, brought together by their exact stamp.

Every output keeps the stamp of its cloud, so equal stamps mean the same cloud and no tolerance is
needed. The number of clouds that wait for a message is bounded.

A node that answers every cloud: inputs of one stamp in, one answer out.

Threads: the executor's callbacks only sort messages by stamp and queue them; one worker thread a node
does the work and publishes, so that services, parameters, lifecycle and diagnostics answer while it is
busy. The queue is bounded and gives up its oldest input, counted as `superseded`.
"""

from __future__ import annotations

import threading
import traceback
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple, TypeVar

from std_msgs.msg import Header

from foretouch.config import setting
from foretouch.ros.messages.conversions import stamp_ns
from foretouch.ros.messages.status import RefusalError, status_name
from foretouch.ros.runtime.lifecycle_node import ForetouchNode, NodeConfig
from foretouch.ros.runtime.workers import Worker
from foretouch_msgs.msg import Status

__all__ = ["ProcessingConfig", "ProcessingNode", "StampSynchronizer", "StampedSet"]


class StampedSet(NamedTuple):
    """Messages by topic, all of one stamp, and when the first of them arrived [s]."""

    messages: dict[str, Any]
    arrived: float


class StampSynchronizer:
    """Collects one message a topic for each stamp. Not thread-safe.

    Args:
        topics: Names of those that make a set.
        depth: Sets that may be incomplete at a time.
        on_open: Called for the first message of each set; what it gives is kept with the set.
        on_drop: Called with a reason for each set given up: `unpaired` (pushed out by newer ones) or
            `repeated_stamp` (a topic sent a stamp twice; the first is given up).
    """

    def __init__(
        self, topics: Sequence[str], depth: int, on_open: Callable[[], float], on_drop: Callable[[str], None]
    ) -> None:
        self._topics = frozenset(topics)
        self._depth = depth
        self._on_open = on_open
        self._on_drop = on_drop
        self._waiting: dict[int, StampedSet] = {}

    def __len__(self) -> int:
        """Incomplete sets."""
        return len(self._waiting)

    def add(self, topic: str, stamp_ns: int, message: Any) -> StampedSet | None:
        """Take one message; the set of its stamp, if that is now complete.

        Args:
            topic: Where it came from.
            stamp_ns: Its stamp [ns].
            message: Whatever is to be handed over.
        """
        found = self._waiting.get(stamp_ns)
        if found is not None and topic in found.messages:
            del self._waiting[stamp_ns]
            self._on_drop("repeated_stamp")
            found = None
        if found is None:
            found = self._waiting[stamp_ns] = StampedSet({}, self._on_open())
        found.messages[topic] = message
        if found.messages.keys() == self._topics:
            return self._waiting.pop(stamp_ns)
        if len(self._waiting) > self._depth:
            del self._waiting[next(iter(self._waiting))]
            self._on_drop("unpaired")
        return None

    def clear(self, reason: str) -> None:
        """Give up all that waits."""
        while self._waiting:
            self._waiting.popitem()
            self._on_drop(reason)


_P = TypeVar("_P", bound="ProcessingConfig")


@dataclass(frozen=True, kw_only=True)
class ProcessingConfig(NodeConfig):
    """Settings of every node that answers clouds."""

    queue_depth: int = setting(
        8, "Inputs that may wait; the oldest is given up for a newer one", minimum=1, maximum=10_000, read_only=True
    )
    pairing_depth: int = setting(
        64,
        "Clouds that may wait for their other messages: more than all queues before this node hold together",
        minimum=1,
        maximum=10_000,
        read_only=True,
    )
    silence_s: float = setting(5.0, "Time without an input that is worth a warning", unit="s", minimum=0.1, maximum=1e6)


class ProcessingNode(ForetouchNode[_P], ABC):
    """Pairs its inputs by stamp and answers each set in a thread of its own.

    Args:
        name: Of the node.
        config_class: Its settings.
        inputs: Message type and name of each topic that makes a set; the first names the cloud.
        options: For rclpy's `Node`.
    """

    def __init__(self, name: str, config_class: type[_P], inputs: Sequence[tuple[type, str]], **options: Any) -> None:
        super().__init__(name, config_class, **options)
        self._topics = tuple(inputs)
        self._lock = threading.Lock()
        names = [topic for _, topic in inputs]
        self._pairing = StampSynchronizer(
            names, self.config.pairing_depth, self.statistics.arrive, self.statistics.drop
        )
        self._worker: Worker[StampedSet] = Worker(
            name, self.config.queue_depth, self._work, lambda _, reason: self.statistics.drop(reason)
        )
        self._outcomes: Counter[str] = Counter()
        self._last_reason = ""

    # What a node fills in.

    @abstractmethod
    def answer(self, messages: dict[str, Any], header: Header) -> tuple[int, str]:
        """Message to arrays, call the core, arrays to message, publish.

        Args:
            messages: By topic, all of one stamp.
            header: Of the first topic.

        Returns:
            The status that was published, and the reason.

        Raises:
            RefusalError: If there is nothing to say; `refuse` then says so.
        """

    @abstractmethod
    def refuse(self, header: Header, status: int, reason: str) -> None:
        """Publish empty outputs with a status and a reason."""

    # Hooks of the base.

    def setup(self) -> None:
        """Subscribe to the inputs."""
        for message, topic in self._topics:
            self.subscribe(message, topic, partial(self._receive, topic))

    def start(self) -> None:
        """Begin to answer."""
        self._worker.start()

    def stop(self) -> None:
        """Finish the cloud at hand and give up what waits."""
        self._worker.stop()
        with self._lock:
            self._pairing.clear("stopped")

    def expects_input_every_s(self) -> float | None:
        """Time without an input that is worth a warning [s]."""
        return self.config.silence_s

    def notes(self) -> dict[str, str]:
        """Answers by status, and why the last was empty."""
        outcomes = {f"answered.{name}": str(count) for name, count in sorted(self._outcomes.items())}
        return {**outcomes, "last_reason": self._last_reason}

    # Its own affairs.

    def _receive(self, topic: str, message: Any) -> None:
        with self._lock:
            found = self._pairing.add(topic, stamp_ns(message.header.stamp), message)
        if found is None:
            return
        if self.state_name == "active":
            self._worker.put(found)
        else:
            self.statistics.drop("inactive")

    def _work(self, job: StampedSet) -> None:
        header = job.messages[self._topics[0][1]].header
        age_s = self.age_s(stamp_ns(header.stamp))
        status, reason = self._answer_or_refuse(job.messages, header)
        self.statistics.use(job.arrived, age_s)
        self._outcomes[status_name(status)] += 1
        self._last_reason = reason
        if status not in (Status.OK, Status.INITIAL_POINTS):
            self.get_logger().warning(f"{status_name(status)}: {reason}", throttle_duration_sec=5.0)

    def _answer_or_refuse(self, messages: dict[str, Any], header: Header) -> tuple[int, str]:
        try:
            return self.answer(messages, header)
        except RefusalError as refusal:
            status, reason = refusal.status, refusal.reason
        except Exception as err:  # noqa: BLE001  a fault of ours must not end the node, nor pass in silence
            self.get_logger().error(traceback.format_exc())
            status, reason = Status.FAILED, f"{type(err).__name__}: {err}"
        self.refuse(header, status, reason)
        return status, reason
