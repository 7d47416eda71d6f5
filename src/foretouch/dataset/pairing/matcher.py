# SPDX-License-Identifier: Apache-2.0
"""From what was planned, told and felt to samples: every executed grasp is linked, or counted out with a reason.

A grasp is linked to its plan, and so to its cloud, by its id alone. Its interval comes from the robot's report, from
the operator's label, or, where neither tells it, from the contact detector. It waits until the readings of its
interval have come, then the touch is cut by stamps.
"""

from __future__ import annotations

from collections import Counter, OrderedDict, deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Generic

from foretouch.dataset.pairing.cloud_buffer import CloudBuffer
from foretouch.dataset.pairing.contact_episodes import Episode
from foretouch.dataset.pairing.cut import Interval, PairingConfig, PairingError, cut_touch
from foretouch.dataset.pairing.matches import Execution, GraspT, Label, MatchedGrasp, Plan, RejectedGrasp
from foretouch.dataset.pairing.touch_buffer import TouchBuffer
from foretouch.tactile.contact_detector import ContactConfig

__all__ = ["GraspTouchMatcher"]

_SECOND_NS = 1_000_000_000
_MOST_PLANS = 10_000
_KEPT_EXECUTIONS = 256  # to notice what is told twice


@dataclass(eq=False)
class _Pending:
    execution: Execution
    told_s: float
    label: Label | None = None


class GraspTouchMatcher(Generic[GraspT]):
    """Keeps what is known of grasps until it is complete. Not thread-safe; every time is given by the caller.

    Args:
        buffer: The readings.
        clouds: Those that are kept.
        config: Settings.
        contact: Settings of the contact detector.
        assume: Whether a contact that nobody tells of belongs to the best grasp of the last cloud before it.

    Attributes:
        outcomes: Executed grasps by outcome: `recorded`, or why they were counted out.
    """

    def __init__(
        self,
        buffer: TouchBuffer,
        clouds: CloudBuffer,
        config: PairingConfig,
        contact: ContactConfig | None = None,
        *,
        assume: bool = False,
    ) -> None:
        self.config = config
        self.outcomes: Counter[str] = Counter()
        self._buffer = buffer
        self._clouds = clouds
        self._contact = contact
        self._assume = assume
        self._plans: OrderedDict[int, Plan[GraspT]] = OrderedDict()
        self._stamp_of: dict[str, int | None] = {}  # None: the id came with two clouds
        self._pending: list[_Pending] = []
        self._waiting: dict[str, Label] = {}  # whose grasp has not been executed yet
        self._finished: OrderedDict[str, None] = OrderedDict()
        self._executions: deque[Execution] = deque(maxlen=_KEPT_EXECUTIONS)
        self._unclaimed: list[tuple[Episode, float]] = []

    @property
    def pending(self) -> int:
        """Grasps that wait for something."""
        return len(self._pending)

    # What comes in.

    def plan(self, stamp_ns: int, frame_id: str, grasps: Sequence[GraspT]) -> None:
        """Take note of the grasps planned on the cloud of this stamp."""
        if not grasps:
            return
        for grasp in grasps:
            known = self._stamp_of.get(grasp.id, stamp_ns)
            self._stamp_of[grasp.id] = stamp_ns if known == stamp_ns else None
        self._plans[stamp_ns] = Plan(stamp_ns, frame_id, tuple(grasps))
        while len(self._plans) > _MOST_PLANS:
            self.forget(next(iter(self._plans)))

    def planned(self, stamp_ns: int) -> Plan[GraspT] | None:
        """The grasps planned on a cloud."""
        return self._plans.get(stamp_ns)

    def forget(self, stamp_ns: int) -> None:
        """Its cloud is no longer kept."""
        plan = self._plans.pop(stamp_ns, None)
        for grasp in () if plan is None else plan.grasps:
            if self._stamp_of.get(grasp.id) == stamp_ns:
                del self._stamp_of[grasp.id]

    def tell(self, execution: Execution, now_s: float) -> None:
        """A grasp was executed."""
        waiting = self._waiting.pop(execution.grasp_id, None)
        self._claim(execution)
        self._pending.append(_Pending(execution, now_s, waiting))

    def feel(self, episode: Episode, now_s: float) -> None:
        """The contact detector saw a contact end; it is left to the robot to tell of it, for `wait_s`."""
        known = [*self._executions, *(one.execution for one in self._pending)]
        if not any(_meets(episode, execution.interval) for execution in known):
            self._unclaimed.append((episode, now_s))

    def label(self, label: Label, now_s: float) -> tuple[str, str]:
        """The operator says something of a grasp.

        Returns:
            The grasp's id, and in words what becomes of the label.

        Raises:
            PairingError: If the grasp is not known, or its sample is complete.
        """
        name = label.grasp_id or self._latest()
        pending = next((one for one in reversed(self._pending) if one.execution.grasp_id == name), None)
        if pending is not None:
            pending.label = label
            return name, "its touch is being recorded"
        if label.interval is None and name in self._finished:
            raise PairingError("too_late", f"grasp {name}: is recorded already; a label comes before or with its grasp")
        if name not in self._stamp_of:
            raise PairingError("grasp_unknown", f"grasp {name}: was not planned while recording")
        self._waiting[name] = label
        if label.interval is None:
            return name, "waits for its contact"
        self.tell(Execution(grasp_id=name, interval=label.interval, flags=("labelled_interval",)), now_s)
        return name, "its touch is being recorded"

    # What comes out.

    def poll(self, now_s: float, *, ending: bool = False) -> list[MatchedGrasp[GraspT] | RejectedGrasp]:
        """What is complete by now; at the end, everything."""
        self._settle_episodes(now_s, ending=ending)
        ready = [one for one in self._pending if ending or self._is_ready(one, now_s)]
        self._pending = [one for one in self._pending if one not in ready]
        results: list[MatchedGrasp[GraspT] | RejectedGrasp] = [self._finish(one) for one in ready]
        for name in list(self._waiting) if ending else []:
            del self._waiting[name]
            results.append(RejectedGrasp(grasp_id=name, reason="no_contact", message="labelled, but never executed"))
        for result in results:
            self.outcomes[result.reason if isinstance(result, RejectedGrasp) else "recorded"] += 1
        return results

    # Its own affairs.

    def _latest(self) -> str:
        if self._pending:
            return self._pending[-1].execution.grasp_id
        if self._executions and self._executions[-1].grasp_id not in self._finished:
            return self._executions[-1].grasp_id
        if not self._plans:
            raise PairingError("grasp_unknown", "there is no grasp to label: none was planned while recording")
        return self._plans[next(reversed(self._plans))].grasps[0].id

    def _claim(self, execution: Execution) -> None:
        self._unclaimed = [pair for pair in self._unclaimed if not _meets(pair[0], execution.interval)]

    def _detected(self, name: str, episode: Episode, flags: tuple[str, ...]) -> Execution:
        contact = min(episode.both + round(self.config.settle_s * _SECOND_NS), episode.release - 1)
        interval = Interval(start=episode.first, contact=contact, release=episode.release)
        return Execution(grasp_id=name, interval=interval, flags=flags)

    def _settle_episodes(self, now_s: float, *, ending: bool) -> None:
        """Contacts that the robot has not told of in time: a waiting label takes them, else perhaps the best grasp."""
        late = [pair for pair in self._unclaimed if ending or now_s - pair[1] > self.config.wait_s]
        self._unclaimed = [pair for pair in self._unclaimed if pair not in late]
        for episode, since_s in late:
            flags: tuple[str, ...] = ("detected_interval",)
            name = self._labelled_before(episode)
            if name is None and self._assume:
                before = [plan for stamp, plan in self._plans.items() if stamp < episode.first]
                name = max(before, key=lambda plan: plan.stamp_ns).grasps[0].id if before else None
                flags = ("detected_interval", "assumed_grasp")
            if name is not None:
                self.tell(self._detected(name, episode, flags), now_s)
            elif now_s - since_s < self.config.kept_s:
                self._unclaimed.append((episode, since_s))  # a label may still come

    def _labelled_before(self, episode: Episode) -> str | None:
        return next(
            (name for name in self._waiting if (self._stamp_of.get(name) or episode.first) < episode.first), None
        )

    def _is_ready(self, one: _Pending, now_s: float) -> bool:
        waited = now_s - one.told_s
        if one.label is None and waited < self.config.label_wait_s:
            return False
        interval = one.execution.interval
        if waited >= self.config.wait_s or interval is None:
            return True
        stamp = self._stamp_of.get(one.execution.grasp_id)
        felt = self._buffer.newest_ns is not None and self._buffer.newest_ns >= interval.release
        return felt and stamp is not None and self._clouds.get(stamp) is not None

    def _finish(self, one: _Pending) -> MatchedGrasp[GraspT] | RejectedGrasp:
        execution = one.execution
        try:
            return self._link(one)
        except PairingError as err:
            return RejectedGrasp(grasp_id=execution.grasp_id, reason=err.reason, message=str(err))
        finally:
            self._executions.append(execution)
            self._finished[execution.grasp_id] = None
            if len(self._finished) > _MOST_PLANS:
                self._finished.popitem(last=False)

    def _link(self, one: _Pending) -> MatchedGrasp[GraspT]:
        execution, interval = one.execution, one.execution.interval
        if interval is None:
            raise PairingError("grasp_failed", "the hand touched nothing")
        plan, grasp = self._find(execution.grasp_id)
        cloud = self._clouds.get(plan.stamp_ns)
        if cloud is None:
            raise PairingError("cloud_unknown", "the cloud that it was planned on did not come, or is long gone")
        if cloud.ambiguous:
            raise PairingError("cloud_ambiguous", f"two clouds were stamped {plan.stamp_ns}")
        if interval.start <= plan.stamp_ns:
            raise PairingError("bad_interval", "it began before the cloud was taken that it was planned on")
        over = [before for before in self._executions if _overlap(before.interval, interval)]
        if over:
            same = over[0].grasp_id == execution.grasp_id
            raise PairingError("told_twice" if same else "overlap", f"grasp {over[0].grasp_id} was told at that time")
        ends = [e.interval.release for e in self._executions if e.interval and e.interval.release <= interval.start]
        cut = cut_touch(self._buffer, interval, self.config, self._contact, max(ends, default=None))
        return MatchedGrasp(grasp, plan, cloud, cut, execution, one.label)

    def _find(self, name: str) -> tuple[Plan[GraspT], GraspT]:
        if name not in self._stamp_of:
            raise PairingError("grasp_unknown", f"grasp {name}: was not planned while recording, or long ago")
        stamp = self._stamp_of[name]
        if stamp is None:
            raise PairingError("grasp_ambiguous", f"grasp {name}: was planned on two clouds")
        plan = self._plans[stamp]
        return plan, next(grasp for grasp in plan.grasps if grasp.id == name)


def _overlap(one: Interval | None, other: Interval) -> bool:
    return one is not None and one.start < other.release and other.start < one.release


def _meets(episode: Episode, interval: Interval | None) -> bool:
    return interval is not None and episode.first < interval.release and interval.start < episode.release
