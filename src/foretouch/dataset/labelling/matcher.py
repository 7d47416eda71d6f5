# SPDX-License-Identifier: Apache-2.0
"""Matches every executed grasp with its plan, its cloud and its touch, or rejects it with a reason.

A grasp is matched with its plan, and so with its cloud, by its id alone. Its interval comes from the robot's report,
from the operator's label, or, where there is neither, from the contact detector. It waits until the readings of its
interval have come, then its touch is cut out by stamps.
"""

from collections import OrderedDict, deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Self

from foretouch.dataset.labelling.buffers import CloudBuffer, SeenObjects, TouchBuffer
from foretouch.dataset.labelling.cut import Interval, PairingConfig, PairingError, cut_touch
from foretouch.tactile.contact_detector import SETTLE_NS
from foretouch.types import SECOND_NS, Outcome, Sample, stamp_ns

_MAX_PLANS = 10_000


@dataclass(frozen=True, kw_only=True)
class ExecutedGrasp:
    """A grasp that was executed."""

    grasp_id: str  # of the planned grasp
    interval: Interval | None  # when it was executed; None where it failed before contact
    success: bool | None = None  # None if unknown
    flags: tuple[str, ...] = ()  # source of an interval that the robot did not report: `labelled_interval`, ...

    @classmethod
    def from_message(cls, message: Any) -> Self:
        """Decode a `foretouch_msgs/ExecutedGrasp` of rclpy or rosbags."""
        start, contact, release = (stamp_ns(time) for time in (message.start, message.contact, message.release))
        touched = message.success or contact or release
        interval = Interval(start=start, contact=contact, release=release) if touched else None
        return cls(grasp_id=message.grasp_id, interval=interval, success=bool(message.success))


@dataclass(frozen=True, kw_only=True)
class Label:
    """What the operator adds to a grasp."""

    grasp_id: str = ""  # "" for the latest
    object: str = ""  # label of the object, "" for the session's object
    discard: bool = False  # whether the sample is not to be used
    note: str = ""  # free text
    outcome: Outcome = "unknown"  # as the operator saw it
    interval: Interval | None = None  # when it was executed; None leaves it to the robot or to the contact detector


class PlannedGrasps(NamedTuple):
    """The grasps planned on one cloud, best first: `foretouch_msgs/Grasp` messages that are not decoded yet, or `Grasp`s."""

    stamp_ns: int
    frame_id: str
    grasps: tuple[Any, ...]


class MatchedGrasp(NamedTuple):
    """An executed grasp with its plan, its cloud and its touch."""

    plan: PlannedGrasps
    cloud: SeenObjects
    sample: Sample  # with touch, tare and readings alone, as of `cut_touch`
    executed: ExecutedGrasp
    label: Label | None


@dataclass(frozen=True, kw_only=True)
class RejectedGrasp:
    """A grasp that makes no sample, with the reason as a short word and in one line."""

    grasp_id: str
    reason: str
    message: str


class GraspTouchMatcher:
    """Collects plans, executed grasps, labels and contacts until a grasp is complete. Not thread-safe.

    If `assume` is set, a contact without a report belongs to the best grasp of the last cloud before it; with
    `successes_only`, grasps that failed after contact are rejected too.
    """

    def __init__(
        self,
        buffer: TouchBuffer,
        clouds: CloudBuffer,
        config: PairingConfig,
        *,
        assume: bool = False,
        successes_only: bool = False,
    ) -> None:
        self.config = config
        self._buffer = buffer
        self._clouds = clouds
        self._assume = assume
        self._successes_only = successes_only
        self.plans: OrderedDict[int, PlannedGrasps] = OrderedDict()  # by the stamp of their cloud [ns], until forgotten
        self._stamps: dict[str, list[int]] = {}  # of the clouds on which an id was planned, until these are forgotten
        self.pending: list[tuple[ExecutedGrasp, float]] = []  # executed, not complete yet, and since when [s]
        self._labels: dict[str, Label] = {}  # of grasps that are not complete yet, or have not been executed
        self._finished_ids: OrderedDict[str, None] = OrderedDict()
        self._finished: deque[ExecutedGrasp] = deque(maxlen=256)  # to reject intervals that overlap with theirs
        self._unclaimed: list[tuple[Interval, float]] = []  # contacts, and when they ended [s]

    # Input.

    def add_plan(self, stamp_ns: int, frame_id: str, grasps: Sequence[Any]) -> None:
        """Add grasps planned on the cloud of this stamp; grasps that were planned on it before are kept."""
        if not grasps:
            return
        for grasp in grasps:
            if stamp_ns not in (stamps := self._stamps.setdefault(grasp.id, [])):
                stamps.append(stamp_ns)
        before, ids = self.plans.get(stamp_ns), {grasp.id for grasp in grasps}
        kept = (
            [planned for planned in before.grasps if planned.id not in ids]
            if before and before.frame_id == frame_id
            else []
        )
        self.plans[stamp_ns] = PlannedGrasps(stamp_ns, frame_id, (*kept, *grasps))
        while len(self.plans) > _MAX_PLANS:
            self.forget_plan(next(iter(self.plans)))

    def forget_plan(self, stamp_ns: int) -> PlannedGrasps | None:
        """Remove the grasps of a cloud that is no longer kept; gives them."""
        plan = self.plans.pop(stamp_ns, None)
        for grasp in () if plan is None else plan.grasps:
            stamps = [stamp for stamp in self._stamps.pop(grasp.id, []) if stamp != stamp_ns]
            if stamps:
                self._stamps[grasp.id] = stamps
        return plan

    def _stamp_of(self, name: str) -> int | None:
        """Return the stamp of the only cloud on which a grasp was planned; None for none or several."""
        stamps = self._stamps.get(name, [])
        return stamps[0] if len(stamps) == 1 else None

    def add_executed(self, executed: ExecutedGrasp, now_s: float) -> None:
        """Add a grasp that was executed."""
        if (interval := executed.interval) is not None:
            self._unclaimed = [pair for pair in self._unclaimed if not interval.overlaps(pair[0])]
        self.pending.append((executed, now_s))

    def add_episode(self, episode: Interval, now_s: float) -> None:
        """Add a contact that has ended; the robot has `wait_s` to report it."""
        known = [
            executed.interval
            for executed in (*self._finished, *(executed for executed, _ in self.pending))
            if executed.interval
        ]
        if not any(interval.overlaps(episode) for interval in known):
            self._unclaimed.append((episode, now_s))

    def add_label(self, label: Label, now_s: float) -> tuple[str, str]:
        """Add the operator's label, and return the grasp's id and a sentence on what happens with the label.

        Raises a `PairingError` if the grasp is not known, or its sample is complete.
        """
        name = label.grasp_id or self._latest()
        if self._is_pending(name):
            self._labels[name] = label
            return name, "its touch is being recorded"
        if label.interval is None and name in self._finished_ids:
            raise PairingError("too_late", f"grasp {name}: is recorded already; `edit_grasp` changes it")
        if name not in self._stamps:
            raise PairingError("grasp_unknown", f"grasp {name}: was not planned while recording")
        self._labels[name] = label
        if label.interval is None:
            return name, "waits for its contact"
        self.add_executed(ExecutedGrasp(grasp_id=name, interval=label.interval, flags=("labelled_interval",)), now_s)
        return name, "its touch is being recorded"

    # Output.

    def expects_grasp(self, now_s: float) -> bool:
        """Return whether a grasp is not complete yet, or a contact has just ended that the robot may still report."""
        return bool(self.pending) or any(now_s - since_s <= self.config.wait_s for _, since_s in self._unclaimed)

    def poll(self, now_s: float, *, ending: bool = False) -> list[MatchedGrasp | RejectedGrasp]:
        """Return the grasps that are complete by now; at the end, all."""
        self._claim_late_episodes(now_s, ending=ending)
        ready = [pair for pair in self.pending if ending or self._is_ready(*pair, now_s)]
        self.pending = [pair for pair in self.pending if pair not in ready]
        results = [self._finish(executed) for executed, _ in ready]
        if ending:
            message = "labelled, but never executed"
            results += [RejectedGrasp(grasp_id=name, reason="no_contact", message=message) for name in self._labels]
            self._labels.clear()
        return results

    def _is_pending(self, name: str) -> bool:
        return any(executed.grasp_id == name for executed, _ in self.pending)

    def _latest(self) -> str:
        if self.pending:
            return self.pending[-1][0].grasp_id
        if not self.plans:
            raise PairingError("grasp_unknown", "there is no grasp to label: none was planned while recording")
        return str(self.plans[next(reversed(self.plans))].grasps[0].id)

    def _claim_late_episodes(self, now_s: float, *, ending: bool) -> None:
        """Give contacts that the robot has not reported in time to a waiting label, else perhaps to the best grasp."""
        late = [pair for pair in self._unclaimed if ending or now_s - pair[1] > self.config.wait_s]
        self._unclaimed = [pair for pair in self._unclaimed if pair not in late]
        for episode, since_s in late:
            waiting = (label for label in self._labels if not self._is_pending(label))
            name = next((label for label in waiting if (self._stamp_of(label) or episode.start) < episode.start), None)
            flags: tuple[str, ...] = ("detected_interval",)
            if name is None and self._assume:
                before = [plan for stamp, plan in self.plans.items() if stamp < episode.start]
                name = max(before, key=lambda plan: plan.stamp_ns).grasps[0].id if before else None
                flags = ("detected_interval", "assumed_grasp")
            if name is not None:
                contact = min(episode.contact + SETTLE_NS, episode.release - 1)
                interval = replace(episode, contact=contact)
                self.add_executed(ExecutedGrasp(grasp_id=name, interval=interval, flags=flags), now_s)
            elif now_s - since_s < self.config.kept_s:
                self._unclaimed.append((episode, since_s))  # a label may still come

    def _is_ready(self, executed: ExecutedGrasp, since_s: float, now_s: float) -> bool:
        interval = executed.interval
        if now_s - since_s >= self.config.wait_s or interval is None:
            return True
        # The guard lets readings come whose stamps jitter, so that the window does not depend on when it is cut.
        complete_ns = interval.release + round(self.config.guard_s * SECOND_NS)
        if self._buffer.newest_ns is None or self._buffer.newest_ns < complete_ns:
            return False
        stamp = self._stamp_of(executed.grasp_id)
        return stamp is not None and self._clouds.get(stamp) is not None

    def _finish(self, executed: ExecutedGrasp) -> MatchedGrasp | RejectedGrasp:
        label = self._labels.pop(executed.grasp_id, None)
        try:
            return self._match(executed, label)
        except PairingError as err:
            return RejectedGrasp(grasp_id=executed.grasp_id, reason=err.reason, message=str(err))
        finally:
            self._finished.append(executed)
            self._finished_ids[executed.grasp_id] = None
            if len(self._finished_ids) > _MAX_PLANS:
                self._finished_ids.popitem(last=False)

    def _match(self, executed: ExecutedGrasp, label: Label | None) -> MatchedGrasp:
        interval = executed.interval
        if interval is None:
            raise PairingError("grasp_failed", "the hand touched nothing")
        if self._successes_only and executed.success is False:
            raise PairingError("grasp_failed", "the robot reports a failure")
        name = executed.grasp_id
        if name not in self._stamps:
            raise PairingError("grasp_unknown", "was not planned on a cloud that is still kept; was its id changed?")
        stamp = self._stamp_of(name)
        if stamp is None:
            raise PairingError("grasp_ambiguous", f"was planned on {len(self._stamps[name])} clouds")
        plan, cloud = self.plans[stamp], self._clouds.get(stamp)
        if cloud is None:
            raise PairingError("cloud_unknown", "its cloud was not received, or is no longer kept")
        if cloud.ambiguous:
            raise PairingError("cloud_ambiguous", f"two different clouds have the stamp {plan.stamp_ns}")
        if interval.start <= plan.stamp_ns:
            raise PairingError("bad_interval", "it began before the cloud that it was planned on was taken")
        intervals = [(before.grasp_id, before.interval) for before in self._finished if before.interval is not None]
        for other, before in intervals:
            if before.overlaps(interval):
                text = f"grasp {other} was reported for that time already"
                raise PairingError("told_twice" if other == name else "overlap", text)
        ends = [before.release for _, before in intervals if before.release <= interval.start]
        sample = cut_touch(self._buffer, interval, self.config, max(ends, default=None))
        return MatchedGrasp(plan, cloud, sample, executed, label)
