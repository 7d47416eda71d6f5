# SPDX-License-Identifier: Apache-2.0
"""The queue of messages that the recorder has received and not yet written."""

from collections import Counter
from dataclasses import dataclass

from foretouch.bounded_queue import BoundedQueue


@dataclass(frozen=True, slots=True)
class Arrival:
    """A serialised message."""

    topic: str  # full name
    data: bytes  # CDR
    received_ns: int  # when the middleware received it [ns]
    sent_ns: int  # when it was published [ns]
    sequence: int | None  # sequence number of its publisher; None where the middleware has none


class MessageQueue(BoundedQueue[Arrival]):
    """Serialised messages between the executor's callbacks and the thread that writes them, with counts by topic.

    It never blocks a callback. Its memory is bounded: the oldest messages are kept, so that the file has one gap only.

    Args:
        most_bytes: That may wait.
    """

    def __init__(self, most_bytes: int) -> None:
        super().__init__(most_bytes, when_full="reject", size_of=lambda arrival: len(arrival.data), on_drop=self._count)
        self._refused: Counter[str] = Counter()
        self._late: Counter[str] = Counter()

    def take(self, timeout_s: float) -> tuple[list[Arrival], Counter[str]]:
        """All messages that wait (see `get_all`), and how many were rejected since the last call, by topic."""
        with self._changed:
            arrivals, refused = self.get_all(timeout_s), self._refused
            self._refused = Counter()
            return arrivals, refused

    def late(self) -> Counter[str]:
        """Messages that came after `close`, by topic."""
        with self._changed:
            return Counter(self._late)

    def waiting(self) -> Counter[str]:
        """Messages that wait, and those rejected since the last `take`, by topic."""
        with self._changed:
            return Counter(arrival.topic for arrival in self._items) + self._refused

    def _count(self, arrival: Arrival, _reason: str) -> None:
        (self._late if self.closed else self._refused)[arrival.topic] += 1
