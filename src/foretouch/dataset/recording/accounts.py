# SPDX-License-Identifier: Apache-2.0
"""What became of every message: received = written + dropped for a reason, for each topic.

Beside it stands what the middleware lost on the way: such messages were never received, and are no part of the sum.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from foretouch.errors import DatasetError

__all__ = ["Accounts", "TopicAccount"]


@dataclass
class TopicAccount:
    """Counts of one topic.

    Attributes:
        received: Messages that arrived.
        written: Messages in the file.
        dropped: Messages given up, by reason.
        lost: Messages that the middleware lost before they arrived.
    """

    received: int = 0
    written: int = 0
    dropped: Counter[str] = field(default_factory=Counter)
    lost: int = 0

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

    def lose(self, topic: str, total: int) -> None:
        """So many messages, in all, were lost on the way here; the count never goes back."""
        if total > 0:
            account = self._of(topic)
            account.lost = max(account.lost, total)

    def add(self, other: Accounts) -> None:
        """Sum up: the counts of another recording beside these."""
        for topic, theirs in other.topics.items():
            account = self._of(topic)
            account.received += theirs.received
            account.written += theirs.written
            account.dropped.update(theirs.dropped)
            account.lost += theirs.lost

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

    def to_record(self) -> dict[str, dict[str, Any]]:
        """By topic, in plain types."""
        return {
            topic: {
                "received": a.received,
                "written": a.written,
                "dropped": dict(sorted(a.dropped.items())),
                "lost": a.lost,
            }
            for topic, a in sorted(self.topics.items())
        }

    def to_mapping(self) -> dict[str, str]:
        """As MCAP metadata: one JSON text a topic."""
        return {topic: json.dumps(counts) for topic, counts in self.to_record().items()}

    @classmethod
    def from_mapping(cls, mapping: Mapping[str, str]) -> Accounts:
        """What `to_mapping` gave; recordings of early versions tell nothing of losses.

        Raises:
            DatasetError: If a text is no account.
        """
        accounts = cls()
        for topic, text in mapping.items():
            try:
                counts = json.loads(text)
                dropped = Counter({str(reason): int(count) for reason, count in counts["dropped"].items()})
                received, written, lost = (
                    int(n) for n in (counts["received"], counts["written"], counts.get("lost", 0))
                )
            except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as err:
                raise DatasetError(f"accounts: {topic}: {text[:80]!r} is no account") from err
            accounts.topics[topic] = TopicAccount(received, written, dropped, lost)
        return accounts

    def _of(self, topic: str) -> TopicAccount:
        return self.topics.setdefault(topic, TopicAccount())
