# SPDX-License-Identifier: Apache-2.0
"""What stands between the executor's callbacks and the thread that writes: a queue that never blocks and counts all."""

from __future__ import annotations

import threading
from collections import Counter, deque
from dataclasses import dataclass

__all__ = ["Arrival", "MessageQueue"]


@dataclass(frozen=True, slots=True)
class Arrival:
    """A serialised message.

    Attributes:
        topic: Full name.
        data: CDR.
        received_ns: When the middleware received it [ns].
        sent_ns: When it was published [ns].
        sequence: Of its publisher; None where the middleware tells none.
    """

    topic: str
    data: bytes
    received_ns: int
    sent_ns: int
    sequence: int | None


class MessageQueue:
    """Messages on their way to the file, bounded in memory; what does not fit is counted, the oldest are kept.

    Args:
        most_bytes: That may wait.
    """

    def __init__(self, most_bytes: int) -> None:
        self._most = most_bytes
        self._changed = threading.Condition()
        self._arrivals: deque[Arrival] = deque()
        self._bytes = 0
        self._waiting: Counter[str] = Counter()
        self._refused: Counter[str] = Counter()
        self._late: Counter[str] = Counter()
        self._closed = False

    def put(self, arrival: Arrival) -> None:
        """Take a message in; returns at once."""
        with self._changed:
            if self._closed:
                self._late[arrival.topic] += 1  # the session's accounts are complete
            elif self._bytes + len(arrival.data) > self._most:
                self._refused[arrival.topic] += 1
            else:
                self._arrivals.append(arrival)
                self._bytes += len(arrival.data)
                self._waiting[arrival.topic] += 1
                if len(self._arrivals) == 1:
                    self._changed.notify()

    def take(self, timeout_s: float) -> tuple[list[Arrival], Counter[str]]:
        """What has come, waiting for the first for so long; and what did not fit since the last call, by topic."""
        with self._changed:
            self._changed.wait_for(lambda: bool(self._arrivals) or self._closed, timeout_s)
            arrivals, refused = list(self._arrivals), self._refused
            self._arrivals.clear()
            self._waiting.clear()
            self._refused, self._bytes = Counter(), 0
            return arrivals, refused

    def close(self) -> None:
        """Take nothing in any more; what is there can still be taken out."""
        with self._changed:
            self._closed = True
            self._changed.notify()

    @property
    def closed(self) -> bool:
        """Whether it takes nothing in any more."""
        with self._changed:
            return self._closed

    def late(self) -> Counter[str]:
        """Messages that came when it was closed already, by topic."""
        with self._changed:
            return Counter(self._late)

    def waiting(self) -> Counter[str]:
        """Messages that wait, those included that did not fit and are not yet told, by topic."""
        with self._changed:
            return self._waiting + self._refused
