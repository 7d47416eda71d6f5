# SPDX-License-Identifier: Apache-2.0
"""Heartbeats, by which the nodes of a graph notice that one of them was killed or hangs.

Discovery lists such a process until its lease has expired, 20 s with the default of Fast DDS, and its last report in /diagnostics stays.
A shorter lease is no remedy: after an interruption that is longer, the names of nodes stay unknown to each other.

Threads: each node publishes its name and its state in a thread of its own, since a transition may keep the executor busy for
seconds. Whenever a node hears itself, it looks which others it does not hear, so one that hears nothing at the moment reports nobody.
"""

import os
import socket
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

from diagnostic_msgs.msg import KeyValue
from rclpy.duration import Duration
from rclpy.exceptions import InvalidHandle
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.lifecycle import LifecycleNode
from rclpy.qos import QoSProfile

from foretouch.ros.runtime.executor import InputGroup

FINALIZED: Final = "finalized"
"""State of a node that says goodbye."""

_PERIOD_S: Final = 0.4
_SILENT_S: Final = 1.0  # after which a node is not counted as the second of its name: it may have been restarted
_GONE_S: Final = 1.4  # after which it is reported, so within 2 s
_HANGS_S: Final = 6.0  # the same if its process still runs, as far as can be seen: the computer may be overloaded
_GOODBYE_S: Final = 1.0  # at most, until all others have heard it
_PARTICIPANT: Final = 12  # bytes of an id that all ends of a process share


class Heartbeat:
    """Publishes that a node lives, and its state, and listens to the others of its namespace.

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
