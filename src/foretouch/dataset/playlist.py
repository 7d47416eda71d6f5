# SPDX-License-Identifier: Apache-2.0
"""What a replay publishes, and when: any source as a sequence of serialised messages.

The clouds come first in importance: they are paced, checked and counted. The other topics of a
recording go along, each message between the clouds it was recorded between.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass

from foretouch.dataset.bag import Message, Recording, Topic
from foretouch.dataset.bag_writer import serialize_cloud
from foretouch.dataset.source import STAMP_STEP_NS, Source
from foretouch.errors import ForetouchError

__all__ = ["CLOUDS", "Pace", "Step", "cloud_is_object", "other_topics", "steps"]

CLOUDS = ""
"""Stands for the topic of the clouds, which the player names."""


@dataclass(frozen=True, eq=False)
class Step:
    """One message to publish.

    Attributes:
        name: Where it comes from, for people.
        topic: As recorded, or `CLOUDS`.
        at_ns: When it was recorded; differences count [ns].
        data: CDR with its encapsulation header; empty where the entry cannot be read.
        stamped: Whether it begins with a `std_msgs/Header`.
        refusal: Why it cannot be read, or "".
    """

    name: str
    topic: str
    at_ns: int
    data: bytes
    stamped: bool = True
    refusal: str = ""


def steps(source: Source, topics: Collection[str] = ()) -> Iterator[Step]:
    """The messages of a source in order.

    Args:
        source: Files, samples or a recording.
        topics: Those of a recording to be played beside its clouds.

    Yields:
        Clouds of a recording exactly as they were recorded, even where their sizes do not add up: to refuse them is
        up to whoever is tested by them. A message that is no valid CDR, and a file that cannot be read, is a `refusal`.

    Raises:
        FileError: Where a recording breaks off.
    """
    if source.kind == "recording":
        yield from _recorded(source, topics)
        return
    for item in source:
        try:
            cloud = item.cloud
            yield Step(item.name, CLOUDS, cloud.stamp_ns, serialize_cloud(cloud))
        except ForetouchError as err:
            yield Step(item.name, CLOUDS, 0, b"", refusal=str(err))


def other_topics(source: Source) -> tuple[Topic, ...]:
    """The topics of a recording beside that of its clouds; none of other sources."""
    if source.kind != "recording":
        return ()
    with Recording(source.path) as recording:
        return tuple(topic for topic in recording.topics if topic.name != source.topic)


def cloud_is_object(source: Source) -> bool:
    """Whether the clouds hold one object each and nothing else, so that there is nothing to segment.

    Samples are such clouds by their nature. Files are taken for scenes where the first that can be
    read is organised like an image, else for objects; recordings for what a camera saw.
    """
    if source.kind != "clouds":
        return source.kind == "samples"
    for item in source:
        try:
            return not item.cloud.organised
        except ForetouchError:
            continue
    return False


class Pace:
    """When the steps of one round are due.

    Args:
        rate_hz: Clouds a second; 0 keeps the times of the recording. Other topics follow the cloud before them.
    """

    def __init__(self, rate_hz: float = 0.0) -> None:
        self._rate_hz = rate_hz
        self._clouds = 0
        self._first_ns: int | None = None
        self._last_ns = 0

    def due_s(self, step: Step) -> float:
        """Time from the start of the round at which to publish the step [s]; call it once a step, in order."""
        if self._first_ns is None:
            self._first_ns = step.at_ns
        self._last_ns = max(self._last_ns, step.at_ns)
        self._clouds += step.topic == CLOUDS
        if self._rate_hz > 0.0:
            return max(self._clouds - 1, 0) / self._rate_hz
        return max(step.at_ns - self._first_ns, 0) * 1e-9

    @property
    def length_ns(self) -> int:
        """Time of the recording until the next round would begin, one mean step after the last cloud [ns]."""
        if self._first_ns is None or self._clouds < 2:
            return STAMP_STEP_NS
        span = self._last_ns - self._first_ns
        return max(span + span // (self._clouds - 1), 1)

    @property
    def length_s(self) -> float:
        """The same as played [s]."""
        return self._clouds / self._rate_hz if self._rate_hz > 0.0 else self.length_ns * 1e-9


def _recorded(source: Source, topics: Collection[str]) -> Iterator[Step]:
    with Recording(source.path) as recording:
        clouds = recording.cloud_topic(source.topic)
        stamped = {topic.name: topic.stamped for topic in recording.topics}
        for message in recording.messages({clouds, *topics}):
            name = f"{source.path}: {message.topic}[{message.index}]"
            topic = CLOUDS if message.topic == clouds else message.topic
            refusal = _refusal(recording, message)
            data = b"" if refusal else message.data
            yield Step(name, topic, message.bag_time_ns, data, stamped[message.topic], refusal)


def _refusal(recording: Recording, message: Message) -> str:
    try:
        recording.content(message)
    except ForetouchError as err:
        return str(err)
    return ""
