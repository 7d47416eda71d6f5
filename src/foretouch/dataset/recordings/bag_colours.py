# SPDX-License-Identifier: Apache-2.0
"""The colours of the depth images in a recording, matched by their stamps as a node does."""

from collections import deque
from collections.abc import Iterable, Iterator
from typing import Final, Protocol, TypeVar

from foretouch.cloud.io.colours import ColourImages
from foretouch.cloud.messages import read_header
from foretouch.errors import DatasetError

_WAIT_NS: Final = 100_000_000  # recorded time for which a depth image is held back for its colours, as in a node


class _Recorded(Protocol):
    """A recorded message."""

    @property
    def topic(self) -> str: ...

    @property
    def bag_time_ns(self) -> int: ...

    @property
    def data(self) -> bytes: ...


_M = TypeVar("_M", bound=_Recorded)


def with_colours(
    messages: Iterable[_M], topic: str, colour_topic: str, images: ColourImages
) -> Iterator[tuple[_M, _M | None]]:
    """Iterate over all messages but those of the colours, in order, each depth image with its colours.

    Args:
        messages: Of a recording.
        topic: Of the depth images.
        colour_topic: Of the colours; "" for none.
        images: Matches them.
    """
    if not colour_topic:
        yield from ((message, None) for message in messages)
        return
    held: deque[_M] = deque()

    def released(now_ns: float) -> Iterator[tuple[_M, _M | None]]:
        while held:
            message = held[0]
            found = None
            if message.topic == topic and (stamp := _stamp(message)) is not None:
                if not images.is_final(stamp) and now_ns < message.bag_time_ns + _WAIT_NS:
                    return
                found = images.match(stamp)
            yield held.popleft(), found

    for message in messages:
        if message.topic == colour_topic:
            if (stamp := _stamp(message)) is not None:
                images.add(stamp, message)
        else:
            held.append(message)
        yield from released(message.bag_time_ns)
    yield from released(float("inf"))


def _stamp(message: _Recorded) -> int | None:
    """Return the stamp of a message [ns]; None for one that is cut off, which is refused where it is decoded."""
    try:
        return read_header(message.data)[0]
    except DatasetError:
        return None
