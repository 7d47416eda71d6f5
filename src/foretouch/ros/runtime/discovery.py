# SPDX-License-Identifier: Apache-2.0
"""What discovery shows of a graph: a second graph in its namespace, and whether publishers and subscribers are matched.

Each node reports in /diagnostics how long it has run and how many ends of its topics are matched (`matched_ends`). A source
of clouds compares that with the ends that discovery shows. A participant of another program may be seen up to three seconds
late, when its next announcement is due. A process that was killed is listed until its lease has expired: 20 s with the
default of Fast DDS, and its last report in /diagnostics stays; a shorter lease is no remedy: after an interruption that is longer,
the names of nodes stay unknown to each other. So the nodes of a graph notice by heartbeats that one of them was killed or hangs.
"""

import os
import socket
import threading
import time
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

from diagnostic_msgs.msg import DiagnosticArray, KeyValue
from rclpy.duration import Duration
from rclpy.exceptions import InvalidHandle
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.lifecycle import LifecycleNode
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSCompatibility, QoSProfile, qos_check_compatible
from rclpy.subscription import Subscription

from foretouch.errors import ConfigError
from foretouch.ros.runtime.executor import InputGroup

UPTIME: Final = "uptime_s"
_SUBSCRIBERS, _PUBLISHERS = "matched_subscribers.", "matched_publishers."
_GRAPH: Final = frozenset({"segmentation", "grasp", "touch_predictor", "replay", "monitor"})  # see `Matching`
FINALIZED: Final = "finalized"
"""State of a node that says goodbye."""

_PERIOD_S: Final = 0.4
_SILENT_S: Final = 1.0  # after which a node is not counted as the second of its name: it may have been restarted
_GONE_S: Final = 1.4  # after which it is reported, so within 2 s
_HANGS_S: Final = 6.0  # the same if its process still runs, as far as can be seen: the computer may be overloaded
_GOODBYE_S: Final = 1.0  # at most, until all others have heard it
_PARTICIPANT: Final = 12  # bytes of an id that all ends of a process share


def find_conflicts(node: Node, topics: Iterable[str], is_silent: Callable[[bytes], bool]) -> tuple[str, ...]:
    """Signs of a second graph in the namespace, which answers every cloud once more without any error, a line each.

    Each of the topics should have one publisher at most. `is_silent` says whether the process of an end, by its id, has
    ended: such are still listed for some seconds. To look takes less than 0.1 ms a topic.
    """
    own = node.get_fully_qualified_name()
    count = sum(_full_name(name, space) == own for name, space in node.get_node_names_and_namespaces())
    found = [f"{count} nodes are named {own}"] if count > 1 else []
    for topic in map(node.resolve_topic_name, topics):
        ends = [end for end in node.get_publishers_info_by_topic(topic) if not is_silent(bytes(end.endpoint_gid))]
        # An end whose node is not discovered yet has no name.
        names = sorted(_node_of(end) for end in ends if end.node_name != "_NODE_NAME_UNKNOWN_")
        if len(names) > 1 and set(names) != {own}:
            found.append(f"{topic} has {len(names)} publishers: {', '.join(names)}")
    return tuple(found)


def matched_ends(
    publishers: Iterable["Publisher[Any]"], subscriptions: Iterable["Subscription[Any]"]
) -> dict[str, int]:
    """Number of matched ends on the other side of each topic, by key of /diagnostics."""
    found = {}
    with suppress(InvalidHandle):  # destroyed meanwhile
        for publisher in publishers:
            found[_SUBSCRIBERS + publisher.topic_name] = int(publisher.get_subscription_count())
        for subscription in subscriptions:
            found[_PUBLISHERS + subscription.topic_name] = int(subscription.get_publisher_count())
    return found


class Matching:
    """What the nodes of a graph wait for before the first cloud, as one of them sees the graph.

    Every node must have run for `discovery_s` [s], and each topic of `wait_for`, or else a `ConfigError`, needs a subscriber
    that is neither a node which answers clouds nor the display.
    """

    def __init__(self, node: Node, discovery_s: float, wait_for: Iterable[str]) -> None:
        self._node = node
        self._discovery_s = discovery_s
        self._reports: dict[str, tuple[float, dict[str, int]]] = {}  # when it began, and its matched ends
        self._wait_for = []
        for name in wait_for:
            try:
                self._wait_for.append(node.resolve_topic_name(name))
            except RuntimeError as err:  # of rcl
                raise ConfigError(f"wait_for: {name!r} is not a valid topic name") from err

    def receive(self, message: DiagnosticArray) -> None:
        """Keep the report of each node, once it has made its publishers."""
        own = self._names()
        for status in message.status:
            values = {pair.key: pair.value for pair in status.values}
            if status.name in own and UPTIME in values and values.get("state") != "unconfigured":
                ends = ((k, int(v)) for k, v in values.items() if k.startswith((_SUBSCRIBERS, _PUBLISHERS)))
                self.report(status.name, float(values[UPTIME]), dict(ends))

    def report(self, name: str, uptime_s: float, ends: Mapping[str, int]) -> None:
        """Keep what is known of a node, by its full name."""
        self._reports[name] = (time.monotonic() - uptime_s, dict(ends))

    def is_discovered(self) -> bool:
        """Whether every node has run for long enough."""
        return all(time.monotonic() - began >= self._discovery_s for began, _ in dict(self._reports).values())

    def missing(self) -> list[str]:
        """What is not matched, of what is seen, a few words each."""
        node, reports, own = self._node, dict(self._reports), self._names()
        found = [
            f"{topic}: no subscriber"
            for topic in self._wait_for
            if own.issuperset(map(_node_of, node.get_subscriptions_info_by_topic(topic)))
        ]
        reporting = set(map(_node_of, node.get_publishers_info_by_topic("/diagnostics")))
        found += [f"{name}: no report in /diagnostics" for name in sorted(own & reporting - reports.keys())]
        for name, (_, ends) in reports.items():
            for key, count in ends.items():
                other, _, topic = key.partition(".")
                wanted = self._compatible(name, topic, _SUBSCRIBERS.startswith(other))
                if count < wanted:
                    found.append(f"{topic}: {wanted - count} of {wanted} {other.removeprefix('matched_')} of {name}")
        return found

    def _names(self) -> set[str]:
        space = self._node.get_namespace()
        return {_full_name(name, space) for name in _GRAPH} | {self._node.get_fully_qualified_name()}

    def _compatible(self, name: str, topic: str, is_publisher: bool) -> int:
        """How many ends a node's end of a topic must match, as far as discovery shows."""
        ends = self._node.get_publishers_info_by_topic(topic), self._node.get_subscriptions_info_by_topic(topic)
        mine, others = ends if is_publisher else ends[::-1]
        if (one := next((end for end in mine if _node_of(end) == name), None)) is None:
            return 0
        pairs = ((one, end) if is_publisher else (end, one) for end in others if end.topic_type == one.topic_type)
        checks = (qos_check_compatible(sent.qos_profile, heard.qos_profile)[0] for sent, heard in pairs)
        return sum(check != QoSCompatibility.ERROR for check in checks)


def _full_name(name: str, namespace: str) -> str:
    return f"{namespace.rstrip('/')}/{name}"


def _node_of(end: Any) -> str:
    return _full_name(end.node_name, end.node_namespace)


class Heartbeat:
    """Publishes that a node lives, and its state, and listens to the others of its namespace.

    It publishes in a thread of its own, since a transition may keep the executor busy for seconds. Whenever a node hears itself, it
    looks which others it does not hear, so one that hears nothing at the moment reports nobody.

    `changed` is called, in the thread of the inputs, when a node is gone or back.

    Attributes:
        gone: By full name of each node that was killed or hangs, when it was last heard (`time.monotonic`) [s].
    """

    def __init__(
        self, node: LifecycleNode, state: Callable[[], str], group: InputGroup, changed: Callable[[], object]
    ) -> None:
        self.gone: dict[str, float] = {}
        self._node, self._state, self._changed = node, state, changed
        self._name = node.get_fully_qualified_name()
        self._process = _own_process()
        self._heard: dict[
            tuple[str, bytes], tuple[float, str]
        ] = {}  # last sign [s] and process, by name and participant
        self._own_s = time.monotonic()
        profile = QoSProfile(depth=100)  # those of all others may wait
        self._publisher: Any = node.create_publisher(KeyValue, "heartbeat", profile)
        node.create_subscription(KeyValue, "heartbeat", self._hear, profile, callback_group=group)
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"heartbeat {self._name}", daemon=True)
        self._thread.start()

    def is_silent(self, end_id: bytes) -> bool:
        """Whether nothing is heard any more of the process that the end of a topic with this id belongs to."""
        signs = [
            at_s for (_, participant), (at_s, _) in tuple(self._heard.items()) if participant == end_id[:_PARTICIPANT]
        ]
        return bool(signs) and self._own_s - max(signs) > _SILENT_S

    def stop(self) -> None:
        """Say goodbye."""
        if not self._stopping.is_set():
            self._stopping.set()
            self._thread.join()
            self._beat(FINALIZED)
            with suppress(_rclpy.RCLError, InvalidHandle):  # what is not yet received is lost with the publisher
                self._publisher.wait_for_all_acked(Duration(seconds=_GOODBYE_S))

    def _run(self) -> None:
        while not self._stopping.wait(_PERIOD_S) and self._node.context.ok():
            self._beat(self._state())

    def _beat(self, state: str) -> None:
        with suppress(_rclpy.RCLError, InvalidHandle):  # the context has just been shut down
            self._publisher.publish(KeyValue(key=self._name, value=f"{state} {self._process}"))

    def _hear(self, message: KeyValue, info: Any) -> None:
        now, name, (state, _, process) = time.monotonic(), message.key, message.value.partition(" ")
        key = name, bytes((info.get("publisher_gid") or {"data": b""})["data"][:_PARTICIPANT])
        if state == FINALIZED:
            self._heard.pop(key, None)
        else:
            self._heard[key] = now, process
        if name != self._name:
            return
        if now - self._own_s > _SILENT_S:  # this node did not hear the others either
            self._heard = {key: (now, process) for key, (_, process) in self._heard.items()}
        self._own_s = now
        last: dict[str, tuple[float, str]] = {}
        for (other, _), sign in self._heard.items():
            last[other] = max(sign, last.get(other, sign))
        before, self.gone = self.gone, {other: one[0] for other, one in last.items() if self._is_gone(*one, now)}
        if self.gone.keys() != before.keys():
            self._changed()

    def _is_gone(self, last_s: float, process: str, now: float) -> bool:
        silent_s = now - last_s
        return silent_s > _GONE_S and (silent_s > _HANGS_S or not _runs(process, self._process))


def _own_process() -> str:
    """The computer, the container and the number of this process; "" where they are not known."""
    with suppress(OSError):
        return f"{socket.gethostname()}/{Path('/proc/self/ns/pid').readlink()}/{os.getpid()}"
    return ""


def _runs(process: str, own: str) -> bool:
    """Whether a process runs, as far as this one can see: in the same computer and container."""
    place, _, number = process.rpartition("/")
    with suppress(OSError):
        status = Path(f"/proc/{number}/stat").read_text(encoding="utf-8", errors="replace").rpartition(")")[2]
        return place == own.rpartition("/")[0] and status.split()[0] not in {"Z", "X"}  # a zombie, or dead
    return False
