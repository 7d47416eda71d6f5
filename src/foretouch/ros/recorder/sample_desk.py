# SPDX-License-Identifier: Apache-2.0
"""Where the recorder's messages are looked into: what each tells, and the samples that come of it. No node, no thread."""

from __future__ import annotations

import threading
import time
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from rclpy.serialization import deserialize_message

from foretouch.dataset.cdr import read_header
from foretouch.dataset.pairing import (
    ALIVE,
    NO_DATA,
    BufferedCloud,
    CloudBuffer,
    ContactEpisodes,
    Execution,
    GraspTouchMatcher,
    Interval,
    Label,
    MatchedGrasp,
    PairingConfig,
    PairingError,
    RejectedGrasp,
    SensorHealth,
    TouchBuffer,
    TouchReading,
)
from foretouch.dataset.recording import SampleRecord
from foretouch.errors import FileError, ForetouchError
from foretouch.ros.messages.conversions import stamp_ns
from foretouch.ros.messages.tactile import TactileAdapter
from foretouch.ros.recorder.message_queue import Arrival
from foretouch.ros.recorder.samples import SampleMaker
from foretouch.tactile.contact_detector import ContactConfig
from foretouch_msgs.msg import ExecutedGrasp, GraspArray

__all__ = ["DeskConfig", "Roles", "SampleDesk"]

_SILENT_S = 1.0  # of the hand
_BLIND_S = 3.0  # the objects of a busy scene may come once a second
_KEPT_ERRORS = 1000


@dataclass(frozen=True, kw_only=True)
class Roles:
    """Full names of the topics that samples are made of."""

    tactile: str
    clouds: str
    grasps: str
    executed: str


@dataclass(frozen=True, kw_only=True)
class DeskConfig:
    """How samples are made.

    Attributes:
        pairing: Of grasps, touches and clouds.
        contact: Of the contact detector.
        assume_grasps: See `GraspTouchMatcher`.
        unlabelled_s: Least time between two samples without a touch [s]; None for none at all.
    """

    pairing: PairingConfig
    contact: ContactConfig
    assume_grasps: bool
    unlabelled_s: float | None


class SampleDesk:
    """Makes samples of messages. All but `label` are called by one thread.

    Args:
        roles: Of the topics.
        adapter: Reads tactile messages.
        maker: Makes the records.
        config: Settings.
        append: Writes a record and gives its id.
        warn: Told of grasps that were counted out, in words.

    Attributes:
        last_sample: Id of the latest with a touch.
        errors_ns: Pairing errors of the latest 1000 [ns].
    """

    def __init__(
        self,
        roles: Roles,
        adapter: TactileAdapter,
        maker: SampleMaker,
        config: DeskConfig,
        append: Callable[[SampleRecord], str],
        warn: Callable[[str], None],
    ) -> None:
        self.last_sample = ""
        self.errors_ns: deque[int] = deque(maxlen=_KEPT_ERRORS)
        self._adapter = adapter
        self._maker = maker
        self._config = config
        self._append = append
        self._warn = warn
        self._take_of = {
            roles.tactile: self._take_tactile,
            roles.clouds: self._take_cloud,
            roles.grasps: self._take_grasps,
            roles.executed: self._take_executed,
        }
        self._buffer = TouchBuffer(config.pairing.kept_s)
        self._clouds = CloudBuffer(config.pairing.kept_s, config.pairing.kept_mb)
        self._book: GraspTouchMatcher[Any] = GraspTouchMatcher(
            self._buffer, self._clouds, config.pairing, config.contact, assume=config.assume_grasps
        )
        self._episodes = ContactEpisodes(config.contact)
        self._jumps = 0
        self._unreadable: Counter[str] = Counter()
        self._used_clouds: set[int] = set()
        self._last_unlabelled_ns: int | None = None
        self._health = SensorHealth()
        self._last_tactile_s = time.monotonic()
        self._last_cloud_s: float | None = None
        self._lock = threading.Lock()  # of the book: labels come from a service

    @property
    def outcomes(self) -> Counter[str]:
        """Executed grasps by outcome."""
        return +self._book.outcomes

    @property
    def sensors(self) -> dict[str, str]:
        """State by finger, and of the camera: `alive`, `no data`, or what is wrong."""
        last = self._last_cloud_s
        sees = last is not None and time.monotonic() - last <= _BLIND_S
        return {**self._health.states, "camera": ALIVE if sees else NO_DATA}

    @property
    def oddities(self) -> Counter[str]:
        """Of the tactile stamps, and messages that could not be read."""
        return self._buffer.oddities + self._unreadable

    def label(self, label: Label) -> tuple[str, str]:
        """What the operator says of a grasp (see `GraspTouchMatcher.label`).

        Raises:
            PairingError: Likewise.
        """
        with self._lock:
            return self._book.label(label, time.monotonic())

    def take(self, arrival: Arrival) -> None:
        """Look into a message; one that makes no sense is counted, and is in the file nevertheless.

        Raises:
            FileError: If a sample is due that the disk does not take.
        """
        take = self._take_of.get(arrival.topic)
        if take is None:
            return
        try:
            with self._lock:
                take(arrival)
        except FileError:
            raise
        except ForetouchError as err:
            name = f"unreadable {arrival.topic}"
            self._unreadable[name] += 1
            if self._unreadable[name] == 1:
                self._warn(f"{arrival.topic}: {err}")

    def settle(self, *, ending: bool = False) -> None:
        """Make the samples that are complete by now; at the end, all (raises as `take`)."""
        if time.monotonic() - self._last_tactile_s > _SILENT_S:
            self._health.silence()
        with self._lock:
            results = self._book.poll(time.monotonic(), ending=ending)
        for result in results:
            if isinstance(result, RejectedGrasp):
                self._warn(f"grasp {result.grasp_id}: no sample: {result.reason}: {result.message}")
            else:
                self._record(result)
        for cloud in self._clouds.clear() if ending else []:
            self._give_up(cloud)

    def _record(self, linked: MatchedGrasp[Any]) -> None:
        try:
            record = self._maker.labelled(linked)
        except PairingError as err:
            self._book.outcomes.subtract({"recorded": 1})
            self._book.outcomes[err.reason] += 1
            self._warn(f"grasp {linked.execution.grasp_id}: no sample: {err.reason}: {err}")
            return
        self.last_sample = self._append(record)
        self._used_clouds.add(linked.cloud.stamp_ns)
        self.errors_ns.append(linked.cut.error_ns)

    def _take_tactile(self, arrival: Arrival) -> None:
        reading = self._adapter.read(deserialize_message(arrival.data, self._adapter.message))
        stamp = arrival.received_ns if reading.stamp_ns is None else reading.stamp_ns
        self._last_tactile_s = time.monotonic()
        self._health.update(reading.counts)
        self._buffer.add(TouchReading(stamp, reading.counts, reading.others, arrival.received_ns))
        if self._buffer.oddities["clock_jump"] != self._jumps:
            self._jumps = self._buffer.oddities["clock_jump"]
            self._episodes.forget()
        episode = self._episodes.update(stamp, reading.counts)
        if episode is not None:
            self._book.feel(episode, time.monotonic())

    def _take_cloud(self, arrival: Arrival) -> None:
        header = read_header(arrival.data)
        self._last_cloud_s = time.monotonic()
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

    def _give_up(self, cloud: BufferedCloud) -> None:
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
            self._append(self._maker.unlabelled(cloud, plan))
        except PairingError as err:
            self._unreadable[f"unlabelled {err.reason}"] += 1
            return
        self._last_unlabelled_ns = cloud.stamp_ns
