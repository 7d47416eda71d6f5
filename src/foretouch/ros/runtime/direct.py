# SPDX-License-Identifier: Apache-2.0
"""Messages between nodes of one process, handed over as objects: not serialised, sent through the middleware and read.

The subscription stays, for publishers of other processes and so that tools show the graph as it is. A publisher of this
process hands its message to the subscriptions that match it, and uses the middleware only if it has further subscribers. What it keeps for
late ones (transient local) is sent when the first of them comes.
The subscriptions recognise the copies that then come through the middleware by their stamp and frame, and leave out as many as
were handed over. So messages without a header are not handed over.
"""

import threading
import weakref
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any, Final

from rclpy.context import Context
from rclpy.lifecycle import LifecyclePublisher
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSCompatibility, qos_check_compatible
from rclpy.subscription import Subscription

from foretouch.ros.messages.clouds import TargetCloud
from foretouch.ros.runtime.workers import WorkerThread

_COPIES: Final = 1000  # at most, on their way to a subscription: more than its queue holds


class DirectPublisher(LifecyclePublisher):
    """A publisher that knows the subscriptions of its process."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self.receivers: tuple[DirectInput, ...] = ()  # given each message; empty without hand-over
        # Whether a late subscriber gets the last messages.
        self.keeps = self.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
        self._unsent: deque[Any] = deque(maxlen=self.qos_profile.depth or None)  # a depth of 0 is no limit
        self._sending = threading.Lock()

    @property
    def wanted(self) -> bool:
        """Whether anything receives the messages, now or later."""
        return self.keeps or bool(self.get_subscription_count())

    def publish(self, message: Any) -> None:
        """Publish a message or a `TargetCloud` while the node is active; without hand-over also a serialised message.

        Nothing is serialised for subscriptions of this process alone.
        """
        if not self.is_activated:
            return
        self.send_unsent(message)
        for one in self.receivers:
            one.receive(message)

    def send_unsent(self, *new: Any) -> None:
        """Send what is kept and new messages, if there is a subscription that they are not handed to; also after a new one."""
        with self._sending:
            receivers = self.receivers
            sends = not receivers or self.get_subscription_count() > len(receivers)
            if sends or self.keeps:
                self._unsent.extend(new)
            while sends and self._unsent:
                message = self._unsent.popleft()
                for one in receivers:
                    one.expect_copy(message)
                Publisher.publish(self, message.message if isinstance(message, TargetCloud) else message)


@dataclass(eq=False)
class DirectInput:
    """A subscription that publishers of its process may call."""

    subscription: "Subscription[Any]"
    receive: Callable[[Any], None]  # called with each message, in the thread of the publisher
    _copies: deque[tuple[int, int, str]] = field(default_factory=lambda: deque(maxlen=_COPIES))
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def expect_copy(self, message: Any) -> None:
        """Call this before a message that is handed over is also sent through the middleware."""
        with self._lock:
            self._copies.append(_key(message))

    def is_copy(self, message: Any) -> bool:
        """Whether a message from the middleware is the copy of one that is handed over; True once for each."""
        if not self._copies:
            return False
        with self._lock, suppress(ValueError):
            self._copies.remove(_key(message))
            return True
        return False


def _key(message: Any) -> tuple[int, int, str]:
    """What a message and its copy have in common."""
    header = message.header
    return header.stamp.sec, header.stamp.nanosec, header.frame_id


def _matches(publisher: DirectPublisher, one: "Subscription[Any]") -> bool:
    """Whether the middleware would deliver the messages."""
    return (
        "header" in publisher.msg_type.get_fields_and_field_types()
        and (publisher.topic_name, publisher.msg_type) == (one.topic_name, one.msg_type)
        and qos_check_compatible(publisher.qos_profile, one.qos_profile)[0] != QoSCompatibility.ERROR
    )


class _DirectTopics:
    """The connected publishers and subscriptions of a process. Thread-safe."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._publishers: list[DirectPublisher] = []
        self._inputs: list[DirectInput] = []
        self._threads: dict[str, WorkerThread] = {}

    def thread(self, namespace: str) -> WorkerThread:
        """The thread that the workers of one graph share."""
        with self._lock:
            if namespace not in self._threads:
                self._threads[namespace] = WorkerThread(f"graph {namespace}")
            return self._threads[namespace]

    def add(self, one: DirectPublisher | DirectInput) -> None:
        """Connect a publisher or a subscription."""
        with self._lock:
            ends: list[Any] = self._publishers if isinstance(one, DirectPublisher) else self._inputs
            ends.append(one)
            self._connect()

    def remove(self, one: DirectPublisher | DirectInput) -> None:
        """Disconnect a publisher or a subscription, before it is destroyed."""
        with self._lock:
            self._publishers = [other for other in self._publishers if other is not one]
            self._inputs = [other for other in self._inputs if other is not one]
            self._connect()

    def _connect(self) -> None:
        for publisher in self._publishers:
            publisher.receivers = tuple(one for one in self._inputs if _matches(publisher, one.subscription))


_of_context: weakref.WeakKeyDictionary[Context, _DirectTopics] = weakref.WeakKeyDictionary()
_lock = threading.Lock()


def direct_topics(context: Context) -> _DirectTopics:
    """The connections of a context of rclpy, of which a process usually has one."""
    with _lock:
        return _of_context.setdefault(context, _DirectTopics())
