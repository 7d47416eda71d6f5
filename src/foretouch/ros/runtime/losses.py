# SPDX-License-Identifier: Apache-2.0
"""Messages that were published but reached no callback.

The middleware reports what the network lost. It does not report a message that a newer one has replaced in the queue of
the subscription, as with a process that does not get to run: only the sequence numbers of the publisher show that.
"""

import threading
from collections.abc import Callable
from typing import Any


class SequenceNumbers:
    """The sequence numbers of the publishers of one topic. Not thread-safe."""

    def __init__(self) -> None:
        self._last: dict[bytes, int] = {}

    def missing(self, info: Any) -> int | None:
        """Messages that are missing since the last of the same publisher; None for a message that was received before.

        Args:
            info: What rclpy passes to a callback beside the message.
        """
        sequence, publisher = info.get("publication_sequence_number"), info.get("publisher_gid")
        if sequence is None or publisher is None:  # the middleware has none
            return 0
        last = self._last.get(publisher["data"])
        if last is not None and sequence <= last:
            return None
        self._last[publisher["data"]] = sequence
        return 0 if last is None else int(sequence - last - 1)


class Losses:
    """Counts the lost messages of one subscription, by gaps in sequence numbers or by events of the middleware.

    Args:
        report: Called with the number of messages at each loss.

    Attributes:
        count: Lost messages.
    """

    def __init__(self, report: Callable[[int], None]) -> None:
        self.count = 0
        self._report = report
        self._lock = threading.Lock()
        self._numbers = SequenceNumbers()
        self._gaps = 0
        self._events = 0

    def arrived(self, info: Any) -> None:
        """Count what is missing before this message."""
        with self._lock:
            self._gaps += self._numbers.missing(info) or 0
            self._update()

    def reported(self, count: int) -> None:
        """Count what the middleware reports as lost."""
        with self._lock:
            self._events += count
            self._update()

    def _update(self) -> None:
        more = max(self._gaps, self._events) - self.count
        if more:
            self.count += more
            self._report(more)
