# SPDX-License-Identifier: Apache-2.0
"""All inputs of the recorder: what arrives goes into the inbox of the session at hand, and how much is known of it."""

from __future__ import annotations

import time
from collections import Counter, deque
from collections.abc import Callable, Sequence
from typing import Any

from rclpy.node import Node

from foretouch.ros.recorder_inbox import Arrival, Inbox
from foretouch.ros.recorder_inputs import InputTopic, RecorderInput
from foretouch.ros.recorder_status import Inflow

__all__ = ["Intake"]

_RATE_TICKS = 11


class Intake:
    """Subscribes to all topics; without a session, what arrives is only counted.

    Args:
        node: Subscribes.
        topics: What to.
        mismatch: See `RecorderInput`.

    Attributes:
        inputs: By full name.
    """

    def __init__(self, node: Node, topics: Sequence[InputTopic], mismatch: Callable[[str, str, Any], None]) -> None:
        self.inputs: dict[str, RecorderInput] = {}
        self._names: dict[str, str] = {}
        self._inbox: Inbox | None = None
        self._late: Counter[str] = Counter()
        self._arrived: Counter[str] = Counter()
        self._ticks: deque[tuple[float, Counter[str]]] = deque(maxlen=_RATE_TICKS)
        try:
            for topic in topics:
                one = RecorderInput(node, topic, self._take, mismatch)
                self.inputs[one.name], self._names[topic.name] = one, one.name
        except BaseException:  # such as an override that names no policy
            self.destroy()
            raise

    def name(self, relative: str) -> str:
        """The full name of a topic, as it was subscribed to."""
        return self._names[relative]

    def open(self, inbox: Inbox) -> None:
        """A session begins: count what is lost from now on, and put what arrives into its inbox."""
        for one in self.inputs.values():
            one.reset()
        self._late.clear()
        self._inbox = inbox

    def close(self) -> None:
        """The session is over."""
        inbox, self._inbox = self._inbox, None
        if inbox is not None:
            self._late = inbox.late()

    def lost(self) -> dict[str, int]:
        """What the middleware has lost since `open`, by topic."""
        return {name: one.lost for name, one in self.inputs.items()}

    def tick(self) -> list[str]:
        """Look at the clock and at what the publishers offer; tells of subscriptions that were made anew."""
        self._ticks.append((time.monotonic(), Counter(self._arrived)))
        return [
            f"{one.name}: is offered {'reliable' if one.reliable else 'best effort'}, and subscribed to likewise"
            for one in self.inputs.values()
            if one.adapt()
        ]

    def inflows(self) -> dict[str, Inflow]:
        """What is known of each topic now."""
        inbox, rates = self._inbox, self._rates()
        waiting: Counter[str] = Counter() if inbox is None else inbox.waiting()
        late = self._late if inbox is None else inbox.late()
        return {
            name: Inflow(waiting=waiting[name], late=late[name], reliable=one.reliable, rate_hz=rates.get(name, 0.0))
            for name, one in self.inputs.items()
        }

    def destroy(self) -> None:
        """Listen no more."""
        for one in self.inputs.values():
            one.destroy()

    def _take(self, arrival: Arrival) -> None:
        self._arrived[arrival.topic] += 1
        inbox = self._inbox
        if inbox is not None:
            inbox.put(arrival)

    def _rates(self) -> dict[str, float]:
        if len(self._ticks) < 2:
            return {}
        (first_s, first), (last_s, last) = self._ticks[0], self._ticks[-1]
        return {name: (last[name] - first[name]) / (last_s - first_s) for name in last}
