# SPDX-License-Identifier: Apache-2.0
"""One session of recording: a thread that takes messages out of the inbox, writes them, and makes samples of them.

It owns the writer, so that waiting for the disk delays no callback. What it tells of itself (`view`) is a value that
is replaced as a whole after each batch.
"""

from __future__ import annotations

import threading
import time
import traceback
from collections import Counter, deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

from foretouch.dataset.recording import RecordingWriter, SampleRecord, TopicAccount
from foretouch.errors import ForetouchError
from foretouch.ros.recorder.message_queue import Arrival, MessageQueue
from foretouch.ros.recorder.sample_desk import SampleDesk

__all__ = ["Session", "SessionView"]

_POLL_S = 0.1
_RATE_WINDOW_S = 10.0


@dataclass(frozen=True, kw_only=True)
class SessionView:
    """What a session has done so far; nothing in it changes.

    Attributes:
        accounts: By topic; neither what waits in the inbox is among it, nor what came after the session had ended.
        samples: With a touch.
        unlabelled: Without.
        outcomes: Executed grasps by outcome.
        oddities: Of the tactile stamps, and messages that could not be read.
        last_sample: Its id.
        pairing_errors_ns: Of the labelled samples, the latest 1000.
        sensors: State by finger, and of the camera.
        bytes_written: Size of the file.
        bytes_per_s: At present.
        free_bytes: Until the session ends by itself.
        error: Why it ended by itself, else "".
    """

    accounts: Mapping[str, TopicAccount] = field(default_factory=dict)
    samples: int = 0
    unlabelled: int = 0
    outcomes: Counter[str] = field(default_factory=Counter)
    oddities: Counter[str] = field(default_factory=Counter)
    last_sample: str = ""
    pairing_errors_ns: tuple[int, ...] = ()
    sensors: Mapping[str, str] = field(default_factory=dict)
    bytes_written: int = 0
    bytes_per_s: float = 0.0
    free_bytes: int = 0
    error: str = ""


class Session:
    """Records until `close`, or until the disk takes no more.

    Args:
        writer: Open; closed here.
        inbox: Where messages come from.
        make_desk: Makes the desk, given what writes a record.
        losses: Tells what the middleware has lost since the session began, by topic.
        warn: Told what goes wrong.

    Attributes:
        desk: Makes the samples.
        view: The state; replaced as a whole.
        ended: Set when everything is written and the file is closed.
    """

    def __init__(
        self,
        writer: RecordingWriter,
        inbox: MessageQueue,
        make_desk: Callable[[Callable[[SampleRecord], str]], SampleDesk],
        losses: Callable[[], Mapping[str, int]],
        warn: Callable[[str], None],
    ) -> None:
        self.writer = writer
        self.desk = make_desk(writer.append)
        self.view = SessionView(sensors=self.desk.sensors)
        self.ended = threading.Event()
        self.began_s = time.monotonic()
        self._inbox = inbox
        self._losses = losses
        self._warn = warn
        self._sizes: deque[tuple[float, int]] = deque()
        writer.before_end = self._book_rest
        self._thread = threading.Thread(target=self._run, name="recorder", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Write what has come, finish what waits, and close the file."""
        self._inbox.close()
        self._thread.join()

    # The thread.

    def _run(self) -> None:
        error = ""
        try:
            while not self._inbox.closed:
                self._work(*self._inbox.take(_POLL_S))
            self._work(*self._inbox.take(0.0), ending=True)
        except ForetouchError as err:
            error = str(err)
        except Exception as err:  # noqa: BLE001  a thread that ends silently would lose everything
            self._warn(traceback.format_exc())
            error = f"{type(err).__name__}: {err}"
        error = self._close(error)
        self._tell(error)
        self.ended.set()

    def _close(self, error: str) -> str:
        try:
            self.writer.close()
        except ForetouchError as err:
            return error or str(err)
        return error

    def _book_rest(self) -> None:
        """Take nothing more in, and account for what nobody will look into: called before the last accounts."""
        self._inbox.close()
        left, refused = self._inbox.take(0.0)
        for topic, count in (Counter(arrival.topic for arrival in left) + refused).items():
            self.writer.receive(topic, count)
            self.writer.drop(topic, "session ended", count)
        self._book_losses()

    def _book_losses(self) -> None:
        for topic, count in self._losses().items():
            self.writer.lose(topic, count)

    def _work(self, arrivals: list[Arrival], refused: Counter[str], *, ending: bool = False) -> None:
        for topic, count in refused.items():
            self.writer.receive(topic, count)
            self.writer.drop(topic, "queue full", count)
        self._book_losses()
        for arrival in arrivals:  # booked before anything can fail
            self.writer.receive(arrival.topic)
        for arrival in arrivals:
            self.writer.write(
                arrival.topic,
                arrival.data,
                arrival.received_ns,
                publish_time_ns=max(0, arrival.sent_ns),
                sequence=None if arrival.sequence is None else arrival.sequence % 2**32,
            )
            self.desk.take(arrival)
        if not arrivals:
            self.writer.flush()  # it looks at its own clock only when something comes
        self.desk.settle(ending=ending)
        self._tell()

    def _tell(self, error: str = "") -> None:
        now, size = time.monotonic(), self.writer.bytes_written
        self._sizes.append((now, size))
        while self._sizes[0][0] < now - _RATE_WINDOW_S:
            self._sizes.popleft()
        since_s, then = self._sizes[0]
        accounts = self.writer.accounts.topics
        self.view = SessionView(
            accounts={name: replace(a, dropped=Counter(a.dropped)) for name, a in list(accounts.items())},
            samples=self.writer.labelled,
            unlabelled=self.writer.samples - self.writer.labelled,
            outcomes=self.desk.outcomes,
            oddities=self.desk.oddities,
            last_sample=self.desk.last_sample,
            pairing_errors_ns=tuple(self.desk.errors_ns),
            sensors=self.desk.sensors,
            bytes_written=size,
            bytes_per_s=(size - then) / (now - since_s) if now > since_s else 0.0,
            free_bytes=0 if error else self.writer.free_bytes,
            error=error,
        )
