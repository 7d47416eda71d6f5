# SPDX-License-Identifier: Apache-2.0
"""The playlist of a replay: any source as a sequence of serialised messages, each with the time at which it is due.

The clouds are paced, checked and counted. Each message of the other topics of a recording is played between the
same clouds as it was recorded.
"""

from collections.abc import Collection, Iterator
from dataclasses import dataclass

from foretouch.dataset.recordings.bag import Recording
from foretouch.dataset.recordings.sample_codec import serialize_cloud
from foretouch.dataset.source import STAMP_STEP_NS, Source
from foretouch.errors import ForetouchError

CLOUDS = ""  # stands for the topic of the clouds, which the replay chooses


@dataclass(frozen=True, eq=False)
class Entry:
    """One message to publish."""

    name: str  # where it comes from, for error messages
    topic: str  # as recorded, or `CLOUDS`
    at_ns: int  # when it was recorded; only differences are used [ns]
    data: bytes  # CDR with its encapsulation header; empty if the entry cannot be read
    stamped: bool = True  # whether it begins with a `std_msgs/Header`
    refusal: str = ""  # why it cannot be read, else ""


def entries(source: Source, topics: Collection[str] = ()) -> Iterator[Entry]:
    """Iterate over the messages of a source in order, for a recording its clouds and these topics.

    Clouds and images of a recording are yielded as they were recorded, even where their sizes do not add up: the subscribers
    must refuse these. Only images that others would read otherwise (`Source.converted`) become clouds. A message that is not valid CDR, or a file that cannot be read, is a `refusal`. Raises a `FileError`
    where a recording is cut off.
    """
    if source.kind == "recording":
        yield from _recorded(source, topics)
        return
    for item in source:
        try:
            yield Entry(item.name, CLOUDS, item.cloud.stamp_ns, serialize_cloud(item.cloud))
        except ForetouchError as err:
            yield Entry(item.name, CLOUDS, 0, b"", refusal=str(err))


def cloud_is_object(source: Source) -> bool:
    """Return whether each cloud holds one object: samples do, and files if the first readable one is not organised."""
    if source.kind != "clouds":
        return source.kind == "samples"
    for item in source:
        try:
            return not item.cloud.organised
        except ForetouchError:
            continue
    return False


class Pace:
    """When the entries of one round are due.

    Args:
        rate_hz: Clouds per second; 0 keeps the times of the recording. Other topics follow the cloud before them.
        longest_pause_s: Longer pauses of a recording, as where its clock was set, are cut to this [s].

    Attributes:
        cut_s: What was cut of the pause before the latest entry [s].
    """

    def __init__(self, rate_hz: float = 0.0, longest_pause_s: float = 10.0) -> None:
        self.cut_s = 0.0
        self._rate_hz = rate_hz
        self._longest_ns = int(longest_pause_s * 1e9)
        self._cut_ns = 0  # in all
        self._clouds = 0
        self._first_ns: int | None = None
        self._last_ns = 0

    def due_s(self, entry: Entry) -> float:
        """Return the time from the start of the round at which to publish the entry [s]; called once per entry, in order."""
        if self._first_ns is None:
            self._first_ns = self._last_ns = entry.at_ns
        cut_ns = max(entry.at_ns - self._last_ns - self._longest_ns, 0) if self._rate_hz <= 0.0 else 0
        self.cut_s = cut_ns * 1e-9
        self._cut_ns += cut_ns
        self._last_ns = max(self._last_ns, entry.at_ns)
        self._clouds += entry.topic == CLOUDS
        if self._rate_hz > 0.0:
            return max(self._clouds - 1, 0) / self._rate_hz
        return max(entry.at_ns - self._first_ns - self._cut_ns, 0) * 1e-9

    @property
    def length_ns(self) -> int:
        """Recorded duration of a round, which ends one mean period after the last cloud [ns]."""
        if self._first_ns is None or self._clouds < 2:
            return STAMP_STEP_NS
        span = self._last_ns - self._first_ns
        return max(span + (span - self._cut_ns) // (self._clouds - 1), 1)

    @property
    def length_s(self) -> float:
        """Played duration of a round [s]."""
        return self._clouds / self._rate_hz if self._rate_hz > 0.0 else (self.length_ns - self._cut_ns) * 1e-9


def _recorded(source: Source, topics: Collection[str]) -> Iterator[Entry]:
    played = {source.topic, *topics}
    with Recording(source.path, source.camera) as recording:
        stamped = {topic.name: topic.stamped for topic in recording.topics}
        info = recording.info_topic(source.topic) if source.converted else ""
        infos = recording.first_info(source.topic)
        colour_topic = source.color_topic if source.converted else ""
        for message, colours in recording.with_colours({*played, info}, source.topic, colour_topic):
            data, refusal = message.data, ""
            try:
                content = recording.content(message)
                if message.topic == info:
                    infos.add(content, message.bag_time_ns * 1e-9)
                if source.converted and message.topic == source.topic:
                    data = serialize_cloud(recording.decode_cloud(message, infos, colours))
            except ForetouchError as err:
                data, refusal = b"", str(err)
            topic = CLOUDS if message.topic == source.topic else message.topic
            name = f"{source.path}: {message.topic}[{message.index}]"
            if message.topic in played:
                yield Entry(name, topic, message.bag_time_ns, data, stamped[message.topic], refusal)
        source.remarks[:] = recording.remarks(source.topic)
