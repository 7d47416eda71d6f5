# SPDX-License-Identifier: Apache-2.0
"""Messages that were published but reached no callback."""

import threading
from collections.abc import Callable
from typing import Any


class Losses:
    """Counts the lost messages of one subscription. Thread-safe.

    The middleware reports what the network lost. It does not report a message that a newer one has replaced in the
    queue of the subscription, as with a process that does not get to run: only gaps in the sequence numbers of the
    publisher show that.

    Args:
        report: Called with the number of messages at each loss.
    """

    def __init__(self, report: Callable[[int], None] = lambda _: None) -> None:
        self.count = 0
        self._report = report
        self._lock = threading.Lock()
        self._last: dict[bytes, int] = {}  # sequence number by publisher
        self._gaps = self._events = 0

    def arrived(self, info: Any) -> bool:
        """Count what is missing before a message; False for one that was received before.

        Args:
            info: What rclpy passes to a callback beside the message.
        """
        sequence, publisher = info.get("publication_sequence_number"), info.get("publisher_gid")
        if sequence is None or publisher is None:  # the middleware has none
            return True
        with self._lock:
            last = self._last.get(publisher["data"], sequence - 1)
            if sequence <= last:
                return False
            self._last[publisher["data"]] = sequence
            self._gaps += int(sequence - last - 1)
            self._update()
        return True

    def reported(self, count: int) -> None:
        """Count what the middleware reports as lost."""
        with self._lock:
            self._events += count
            self._update()

    def reset(self) -> None:
        """Restart the count."""
        with self._lock:
            self.count = self._gaps = self._events = 0

    def _update(self) -> None:
        more = max(self._gaps, self._events) - self.count
        if more:
            self.count += more
            self._report(more)
