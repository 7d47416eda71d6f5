# SPDX-License-Identifier: Apache-2.0
"""Message counts of a recording: received = written + dropped (by reason), for each topic.

Messages that the middleware lost before they arrived were never received; they are counted separately.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from foretouch.checked_files import parse_json
from foretouch.errors import DatasetError


@dataclass
class TopicCounts:
    """Counts of one topic."""

    received: int = 0  # messages that arrived
    written: int = 0  # messages in the file
    dropped: Counter[str] = field(default_factory=Counter)  # messages discarded, by reason
    lost: int = 0  # messages that the middleware lost before they arrived

    @property
    def pending(self) -> int:
        """Received, and neither written nor dropped yet: in a queue or in the next chunk."""
        return self.received - self.written - self.dropped.total()

    def drop(self, reason: str, count: int) -> None:
        """Count messages as discarded."""
        if count > 0:
            self.dropped[reason] += count


@dataclass
class MessageCounts:
    """The counts of a recording, by topic."""

    topics: dict[str, TopicCounts] = field(default_factory=dict)

    def topic(self, name: str) -> TopicCounts:
        """The counts of one topic, created if needed."""
        return self.topics.setdefault(name, TopicCounts())

    def add(self, other: MessageCounts) -> None:
        """Add the counts of another recording."""
        for name, theirs in other.topics.items():
            counts = self.topic(name)
            counts.received += theirs.received
            counts.written += theirs.written
            counts.dropped.update(theirs.dropped)
            counts.lost += theirs.lost

    def to_record(self) -> dict[str, dict[str, Any]]:
        """By topic, in plain types."""
        return {
            name: {
                "received": counts.received,
                "written": counts.written,
                "dropped": dict(sorted(counts.dropped.items())),
                "lost": counts.lost,
            }
            for name, counts in sorted(self.topics.items())
        }

    def to_mapping(self) -> dict[str, str]:
        """As MCAP metadata: one JSON text a topic."""
        return {name: json.dumps(counts) for name, counts in self.to_record().items()}

    @classmethod
    def from_mapping(cls, mapping: Mapping[str, str]) -> MessageCounts:
        """Parse the result of `to_mapping`; a `DatasetError` if a text is invalid."""
        result = cls()
        for name, text in mapping.items():
            try:
                counts = parse_json(text)
                dropped = Counter({str(reason): int(count) for reason, count in counts["dropped"].items()})
                received, written, lost = (int(counts[key]) for key in ("received", "written", "lost"))
            except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as err:
                raise DatasetError(f"message counts: {name}: {text[:80]!r} holds no counts") from err
            result.topics[name] = TopicCounts(received, written, dropped, lost)
        return result
