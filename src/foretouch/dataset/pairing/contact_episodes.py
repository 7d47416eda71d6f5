# SPDX-License-Identifier: Apache-2.0
"""Times in which both fingers held something, as the contact detector saw them."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from foretouch.tactile.contact_detector import ContactConfig, ContactDetector
from foretouch.types import Float32

__all__ = ["ContactEpisodes", "Episode"]

_KEPT = 64


@dataclass(frozen=True, kw_only=True)
class Episode:
    """One contact of both fingers, by the sensor's stamps [ns].

    Attributes:
        first: Of the finger that touched first.
        both: Of the other.
        release: Of the finger that let go first.
    """

    first: int
    both: int
    release: int


class ContactEpisodes:
    """Watches the stream. Not thread-safe.

    Attributes:
        ended: The latest episodes, oldest first.
        onsets: Contacts that began, of either finger.
    """

    def __init__(self, config: ContactConfig | None = None) -> None:
        self.ended: deque[Episode] = deque(maxlen=_KEPT)
        self.onsets = 0
        self._detector = ContactDetector(config)
        self._onset: dict[str, int] = {}
        self._holding = False

    @property
    def touching(self) -> tuple[str, ...]:
        """The fingers that are in contact."""
        return tuple(name for name, finger in self._detector.fingers.items() if finger.touching)

    def update(self, stamp_ns: int, counts: Float32) -> Episode | None:
        """Take a reading of both fingers; gives the episode that it ends."""
        changes = self._detector.update(stamp_ns, counts)
        if not changes:
            return None
        for change in changes:
            if change.kind == "onset":
                self._onset[change.finger] = change.stamp_ns
                self.onsets += 1
        before, self._holding = self._holding, self._detector.holding
        if not before or self._holding:
            return None
        first, both = sorted(self._onset.values())
        released = min(change.stamp_ns for change in changes if change.kind == "release")
        episode = Episode(first=first, both=both, release=released)
        self.ended.append(episode)
        return episode

    def forget(self) -> None:
        """Begin anew, after the clock has jumped."""
        self._detector.forget()
        self._holding = False
