# SPDX-License-Identifier: Apache-2.0
"""A file of a recording, and its message counts.

Reading, verification and repair all use one `RecordingFile`.

Of the message counts in a recording, received = written + dropped (by reason), for each topic. Messages that the
middleware lost before they arrived were never received; they are counted separately.
"""

import json
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Self

from mcap.records import Metadata

from foretouch.base.files import COUNT, parse_json, require_schema
from foretouch.dataset.recordings.folder import is_dataset
from foretouch.dataset.recordings.mcap import McapReader
from foretouch.dataset.recordings.sample_codec import ABOUT, COUNTS
from foretouch.errors import DatasetError, FileError


class RecordingFile(McapReader):
    """One file of a recording, or an MCAP file of others.

    Attributes:
        counts: The last message counts; None without them.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self.counts: MessageCounts | None = None

    @property
    def is_own(self) -> bool:
        """Whether foretouch recorded it, as far as it was read."""
        return self.header.library.startswith("foretouch ") or ABOUT in self.metadata or is_dataset(self.path.parent)

    def _declared(self, content: Any) -> None:
        if isinstance(content, Metadata) and content.name == COUNTS:
            self.counts = MessageCounts.from_mapping(content.metadata)
        super()._declared(content)


_COUNTED: Final = ("received", "written", "lost")


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
        """Return the counts of one topic, created if needed."""
        return self.topics.setdefault(name, TopicCounts())

    def add(self, other: "MessageCounts") -> None:
        """Add the counts of another recording."""
        for name, theirs in other.topics.items():
            counts = self.topic(name)
            counts.received += theirs.received
            counts.written += theirs.written
            counts.dropped.update(theirs.dropped)
            counts.lost += theirs.lost

    def to_record(self) -> dict[str, dict[str, Any]]:
        """Return the counts by topic, in plain types."""
        return {
            name: {**vars(counts), "dropped": dict(sorted(counts.dropped.items()))}
            for name, counts in sorted(self.topics.items())
        }

    def to_mapping(self) -> dict[str, str]:
        """Write the counts as MCAP metadata: one JSON text a topic."""
        return {name: json.dumps(counts) for name, counts in self.to_record().items()}

    @classmethod
    def from_mapping(cls, mapping: Mapping[str, str]) -> Self:
        """Parse the result of `to_mapping`; a `DatasetError` if a text is invalid."""
        result = cls()
        for name, text in mapping.items():
            try:
                counts = parse_json(text)
                require_schema("", counts, {**dict.fromkeys(_COUNTED, COUNT), "dropped": {"*": COUNT}})
                received, written, lost = (counts[key] for key in _COUNTED)
                dropped = Counter(counts["dropped"])
            except (ValueError, FileError) as err:
                raise DatasetError(f"message counts: {name}: {text[:80]!r} holds no counts") from err
            result.topics[name] = TopicCounts(received, written, dropped, lost)
        return result
