# SPDX-License-Identifier: Apache-2.0
"""Messages between nodes of one process, handed over as objects: not serialised, sent through the middleware and read.

The subscription stays, for publishers of other processes and so that tools show the graph as it is. A publisher of this
process hands its message to the subscriptions that match it, and uses the middleware only if it has further subscribers, or keeps its
last messages for late ones.
The subscriptions recognise such messages by the id of their publisher and leave them. rclpy passes that id since Kilted: on
Jazzy nothing is handed over.
"""

import threading
import weakref
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

from rclpy import subscription as rclpy_subscription
from rclpy.context import Context
from rclpy.lifecycle import LifecyclePublisher
from rclpy.qos import DurabilityPolicy, QoSCompatibility, qos_check_compatible
from rclpy.serialization import deserialize_message
from rclpy.subscription import Subscription

from foretouch.ros.messages.clouds import TargetCloud
from foretouch.ros.runtime.workers import WorkerThread

SUPPORTED: Final = hasattr(rclpy_subscription, "MessageInfo")
"""Whether rclpy passes the publisher of a message."""

ID_BYTES = 16  # of a publisher; some versions of ROS pad them


class DirectPublisher(LifecyclePublisher):  # type: ignore[type-arg]  # not generic before Kilted
    """A publisher that knows the subscriptions of its process."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self.receivers: tuple[Callable[[Any], None], ...] = ()  # called with each message; empty without hand-over
        self.id = b""  # as subscribers see it; empty if the middleware has none
        # Whether a late subscriber gets the last messages.
        self.keeps = self.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL

    @property
    def wanted(self) -> bool:
        """Whether anything receives the messages, now or later."""
        return self.keeps or bool(self.get_subscription_count())

    def publish(self, message: Any) -> None:
        """Publish a message, a `TargetCloud` or a serialised message while the node is active.

        Nothing is serialised for subscriptions of this process alone, unless it is kept for late ones.
        """
        if not self.is_activated:
            return
        receivers = self.receivers
        if not receivers or self.keeps or self.get_subscription_count() > len(receivers):
            super().publish(message.message if isinstance(message, TargetCloud) else message)
        if receivers and isinstance(message, bytes):
            message = deserialize_message(message, self.msg_type)
        for receive in receivers:
            receive(message)


@dataclass(eq=False)
class DirectInput:
    """A subscription that publishers of its process may call."""

    subscription: "Subscription[Any]"
    receive: Callable[[Any], None]  # called with each message, in the thread of the publisher
    ids: frozenset[bytes] = frozenset()  # of the publishers that call it or did: what they have sent may be on its way

    def has_received(self, info: Any) -> bool:
        """Whether a message from the middleware was handed over; `info` is what rclpy passes beside the message."""
        publisher = info.get("publisher_gid")
        return publisher is not None and publisher["data"][:ID_BYTES] in self.ids


def _matches(publisher: DirectPublisher, one: "Subscription[Any]") -> bool:
    """Whether the middleware would deliver the messages."""
    return (
        bool(publisher.id)
        and (publisher.topic_name, publisher.msg_type) == (one.topic_name, one.msg_type)
        and qos_check_compatible(publisher.qos_profile, one.qos_profile)[0] != QoSCompatibility.ERROR
    )


class _DirectTopics:
    """The connected publishers and subscriptions of a process. Thread-safe."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._publishers: list[DirectPublisher] = []
        self._inputs: list[DirectInput] = []
        self._threads: weakref.WeakValueDictionary[str, WorkerThread] = weakref.WeakValueDictionary()

    def thread(self, namespace: str) -> WorkerThread:
        """The thread that the workers of one graph share."""
        with self._lock:
            return self._threads.setdefault(namespace, WorkerThread(f"graph {namespace}"))

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
            publisher.receivers = tuple(one.receive for one in self._inputs if _matches(publisher, one.subscription))
        for one in self._inputs:
            one.ids |= {publisher.id for publisher in self._publishers if _matches(publisher, one.subscription)}


_of_context: weakref.WeakKeyDictionary[Context, _DirectTopics] = weakref.WeakKeyDictionary()
_lock = threading.Lock()


def direct_topics(context: Context) -> _DirectTopics:
    """The connections of a context of rclpy, of which a process usually has one."""
    with _lock:
        return _of_context.setdefault(context, _DirectTopics())
