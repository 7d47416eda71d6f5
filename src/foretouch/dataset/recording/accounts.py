# SPDX-License-Identifier: Apache-2.0
"""What became of every message: received = written + dropped for a reason, for each topic."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field

from foretouch.errors import DatasetError

__all__ = ["Accounts", "TopicAccount"]


@dataclass
class TopicAccount:
    """Counts of one topic.

    Attributes:
        received: Messages that arrived.
        written: Messages in the file.
        dropped: Messages given up, by reason.
    """

    received: int = 0
    written: int = 0
    dropped: Counter[str] = field(default_factory=Counter)

    @property
    def pending(self) -> int:
        """Received, and neither written nor dropped yet: in a queue or in the chunk to come."""
        return self.received - self.written - self.dropped.total()


class Accounts:
    """The accounts of a recording, by topic."""

    def __init__(self) -> None:
        self.topics: dict[str, TopicAccount] = {}

    def receive(self, topic: str, count: int = 1) -> None:
        """Messages arrived; each must be written or dropped later."""
        self._of(topic).received += count

    def write(self, topic: str, count: int = 1) -> None:
        """Messages are in the file."""
        self._of(topic).written += count

    def drop(self, topic: str, reason: str, count: int = 1) -> None:
        """Messages were given up."""
        self._of(topic).dropped[reason] += count

    def settle(self, reason: str) -> None:
        """Drop what is pending: at the end, nothing may be."""
        for account in self.topics.values():
            if account.pending > 0:
                account.dropped[reason] += account.pending

    def faults(self) -> list[str]:
        """Topics whose counts do not add up, one line each."""
        return [
            f"{topic}: received {a.received} is not written {a.written} + dropped {a.dropped.total()}"
            for topic, a in sorted(self.topics.items())
            if a.pending
        ]

    def to_mapping(self) -> dict[str, str]:
        """As MCAP metadata: one JSON text a topic."""
        return {
            topic: json.dumps(
                {"received": a.received, "written": a.written, "dropped": dict(sorted(a.dropped.items()))}
            )
            for topic, a in sorted(self.topics.items())
        }

    @classmethod
    def from_mapping(cls, mapping: Mapping[str, str]) -> Accounts:
        """What `to_mapping` gave.

        Raises:
            DatasetError: If a text is no account.
        """
        accounts = cls()
        for topic, text in mapping.items():
            try:
                counts = json.loads(text)
                dropped = Counter({str(reason): int(count) for reason, count in counts["dropped"].items()})
                accounts.topics[topic] = TopicAccount(int(counts["received"]), int(counts["written"]), dropped)
            except (ValueError, KeyError, TypeError, AttributeError) as err:
                raise DatasetError(f"accounts: {topic}: {text[:80]!r} is no account") from err
        return accounts

    def _of(self, topic: str) -> TopicAccount:
        return self.topics.setdefault(topic, TopicAccount())
