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
from typing import Any

from rclpy.serialization import deserialize_message

from foretouch.dataset.cdr import read_header
from foretouch.dataset.pairing import (
    ContactEpisodes,
    CountedOut,
    Execution,
    GraspBook,
    Interval,
    KeptCloud,
    KeptClouds,
    Label,
    PairingConfig,
    PairingError,
    SensorHealth,
    TouchBuffer,
    TouchReading,
)
from foretouch.dataset.recording import RecordingWriter, TopicAccount
from foretouch.errors import ForetouchError, TactileError
from foretouch.ros.conversions import stamp_ns
from foretouch.ros.recorder_inbox import Arrival, Inbox
from foretouch.ros.recorder_samples import SampleMaker
from foretouch.ros.tactile_adapters import TactileAdapter
from foretouch.tactile.contact_detector import ContactConfig
from foretouch_msgs.msg import ExecutedGrasp, GraspArray

__all__ = ["Roles", "Session", "SessionConfig", "SessionView"]

_POLL_S = 0.1
_SILENT_S = 1.0
_RATE_WINDOW_S = 10.0


@dataclass(frozen=True, kw_only=True)
class Roles:
    """Full names of the topics that samples are made of."""

    tactile: str
    clouds: str
    grasps: str
    executed: str


@dataclass(frozen=True, kw_only=True)
class SessionConfig:
    """What a session is made with."""

    pairing: PairingConfig
    contact: ContactConfig
    assume_grasps: bool
    unlabelled_s: float | None


@dataclass(frozen=True, kw_only=True)
class SessionView:
    """What a session has done so far; nothing in it changes.

    Attributes:
        accounts: By topic; what waits in the inbox is not among it.
        samples: With a touch.
        unlabelled: Without.
        outcomes: Executed grasps by outcome.
        oddities: Of the tactile stamps, and messages that could not be read.
        last_sample: Its id.
        pairing_errors_ns: Of the labelled samples, the latest 1000.
        sensors: State by finger.
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
        roles: Of the topics.
        adapter: Reads tactile messages.
        maker: Makes the records.
        config: Settings.
        warn: Told of grasps that were counted out, in words.

    Attributes:
        view: The state; replaced as a whole.
        ended: Set when everything is written and the file is closed.
    """

    def __init__(
        self,
        writer: RecordingWriter,
        inbox: Inbox,
        roles: Roles,
        adapter: TactileAdapter,
        maker: SampleMaker,
        config: SessionConfig,
        warn: Callable[[str], None],
    ) -> None:
        self.view = SessionView(sensors=SensorHealth().states)
        self.ended = threading.Event()
        self.writer = writer
        self.began_s = time.monotonic()
        self._inbox = inbox
        self._adapter = adapter
        self._maker = maker
        self._config = config
        self._warn = warn
        self._take_of = {
            roles.tactile: self._take_tactile,
            roles.clouds: self._take_cloud,
            roles.grasps: self._take_grasps,
            roles.executed: self._take_executed,
        }
        self._buffer = TouchBuffer(config.pairing.kept_s)
        self._clouds = KeptClouds(config.pairing.kept_s, config.pairing.kept_mb)
        self._book: GraspBook[Any] = GraspBook(
            self._buffer, self._clouds, config.pairing, config.contact, assume=config.assume_grasps
        )
        self._episodes = ContactEpisodes(config.contact)
        self._health = SensorHealth()
        self._jumps = 0
        self._unreadable: Counter[str] = Counter()
        self._used_clouds: set[int] = set()
        self._last_unlabelled_ns: int | None = None
        self._last_tactile_s = time.monotonic()
        self._last_sample = ""
        self._errors_ns: deque[int] = deque(maxlen=1000)
        self._sizes: deque[tuple[float, int]] = deque()
        self._lock = threading.Lock()  # of the book: labels come from a service
        self._thread = threading.Thread(target=self._run, name="recorder", daemon=True)
        self._thread.start()

    def label(self, label: Label) -> tuple[str, str]:
        """What the operator says of a grasp (see `GraspBook.label`).

        Raises:
            PairingError: Likewise.
        """
        with self._lock:
            return self._book.label(label, time.monotonic())

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
            self._finish()
        except ForetouchError as err:
            error = str(err)
        except Exception as err:  # noqa: BLE001  a thread that ends silently would lose everything
            self._warn(traceback.format_exc())
            error = f"{type(err).__name__}: {err}"
        error = self._close(error)
        self._tell(error)
        self.ended.set()

    def _close(self, error: str) -> str:
        """Account for what is left, and close the file."""
        self._inbox.close()
        left, refused = self._inbox.take(0.0)
        for topic, count in (Counter(arrival.topic for arrival in left) + refused).items():
            self.writer.receive(topic, count)
            self.writer.drop(topic, "session ended", count)
        try:
            self.writer.close()
        except ForetouchError as err:
            return error or str(err)
        finally:
            self.writer.accounts.settle("session ended")
        return error

    def _work(self, arrivals: list[Arrival], refused: Counter[str], *, ending: bool = False) -> None:
        for topic, count in refused.items():
            self.writer.receive(topic, count)
            self.writer.drop(topic, "queue full", count)
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
            take = self._take_of.get(arrival.topic)
            if take is not None:
                self._read(take, arrival)
        if not arrivals:
            self.writer.flush()  # it looks at its own clock only when something comes
        self._settle(ending=ending)
        self._tell()

    def _read(self, take: Callable[[Arrival], None], arrival: Arrival) -> None:
        """Look into a message; one that makes no sense is in the file nevertheless."""
        try:
            with self._lock:
                take(arrival)
        except ForetouchError as err:
            self._unreadable[f"unreadable {arrival.topic}"] += 1
            if self._unreadable[f"unreadable {arrival.topic}"] == 1:
                self._warn(f"{arrival.topic}: {err}")

    def _take_tactile(self, arrival: Arrival) -> None:
        reading = self._adapter.read(deserialize_message(arrival.data, self._adapter.message))
        stamp = arrival.received_ns if reading.stamp_ns is None else reading.stamp_ns
        self._last_tactile_s = time.monotonic()
        self._health.update(reading.counts)
        if not (reading.counts > 0).any():
            raise TactileError("all counts are 0: no sensor")
        self._buffer.add(TouchReading(stamp, reading.counts, reading.others, arrival.received_ns))
        if self._buffer.oddities["clock_jump"] != self._jumps:
            self._jumps = self._buffer.oddities["clock_jump"]
            self._episodes.forget()
        episode = self._episodes.update(stamp, reading.counts)
        if episode is not None:
            self._book.feel(episode, time.monotonic())

    def _take_cloud(self, arrival: Arrival) -> None:
        header = read_header(arrival.data)
        for gone in self._clouds.add(header.stamp_ns, arrival.data, time.monotonic()):
            self._give_up(gone)

    def _take_grasps(self, arrival: Arrival) -> None:
        message: Any = deserialize_message(arrival.data, GraspArray)
        self._book.plan(stamp_ns(message.header.stamp), message.header.frame_id, message.grasps)

    def _take_executed(self, arrival: Arrival) -> None:
        message: Any = deserialize_message(arrival.data, ExecutedGrasp)
        start, contact, release = (stamp_ns(t) for t in (message.start, message.contact, message.release))
        felt = bool(message.success or contact or release)
        interval = Interval(start=start, contact=contact, release=release) if felt else None
        execution = Execution(grasp_id=message.grasp_id, interval=interval, success=bool(message.success))
        self._book.tell(execution, time.monotonic())

    # Samples.

    def _settle(self, *, ending: bool) -> None:
        if time.monotonic() - self._last_tactile_s > _SILENT_S:
            self._health.silence()
        with self._lock:
            results = self._book.poll(time.monotonic(), ending=ending)
        for result in results:
            if isinstance(result, CountedOut):
                self._warn(f"grasp {result.grasp_id}: no sample: {result.reason}: {result.message}")
                continue
            try:
                record = self._maker.labelled(result)
            except PairingError as err:
                self._book.outcomes.subtract({"recorded": 1})
                self._book.outcomes[err.reason] += 1
                self._warn(f"grasp {result.execution.grasp_id}: no sample: {err}")
                continue
            self._last_sample = self.writer.append(record)
            self._used_clouds.add(result.cloud.stamp_ns)
            self._errors_ns.append(result.cut.error_ns)

    def _give_up(self, cloud: KeptCloud) -> None:
        """A cloud that no grasp has asked for becomes a sample without a touch, at most one in so many seconds."""
        plan, every_s = self._book.planned(cloud.stamp_ns), self._config.unlabelled_s
        self._book.forget(cloud.stamp_ns)
        if cloud.stamp_ns in self._used_clouds:
            self._used_clouds.discard(cloud.stamp_ns)
            return
        if plan is None or every_s is None or cloud.ambiguous:
            return
        last = self._last_unlabelled_ns
        if last is not None and abs(cloud.stamp_ns - last) < every_s * 1e9:
            return
        try:
            self.writer.append(self._maker.unlabelled(cloud, plan))
        except PairingError as err:
            self._unreadable[f"unlabelled {err.reason}"] += 1
            return
        self._last_unlabelled_ns = cloud.stamp_ns

    def _finish(self) -> None:
        for cloud in self._clouds.clear():
            self._give_up(cloud)

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
            outcomes=+self._book.outcomes,
            oddities=self._buffer.oddities + self._unreadable,
            last_sample=self._last_sample,
            pairing_errors_ns=tuple(self._errors_ns),
            sensors=dict(self._health.states),
            bytes_written=size,
            bytes_per_s=(size - then) / (now - since_s) if now > since_s else 0.0,
            free_bytes=0 if error else self.writer.free_bytes,
            error=error,
        )
