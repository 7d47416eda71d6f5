# SPDX-License-Identifier: Apache-2.0
"""Which grasp gets which cloud and which touch: ids and stamps decide, in whatever order messages come."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from every_case import every_case
from pair_builders import SECOND, Named, interval, level, stream

from foretouch.dataset.labelling.buffers import CloudBuffer, SeenObjects, TouchBuffer
from foretouch.dataset.labelling.cut import Interval, PairingConfig, PairingError
from foretouch.dataset.labelling.matcher import ExecutedGrasp, GraspTouchMatcher, Label, MatchedGrasp, RejectedGrasp
from foretouch.dataset.labelling.sensors import ContactEpisodes
from foretouch.types import ASSUMED_TABLE, Cloud
from foretouch.types.scene import Object
from foretouch_lab.simulation.message_faults import FaultConfig

CONFIG = PairingConfig(wait_s=1.0)


def seen(at: float) -> tuple[Object, ...]:
    """One object, all of whose points are at a place [m]."""
    return (Object.of("", Cloud(np.full((5, 3), at, np.float32)), ASSUMED_TABLE),)


class Session:
    """A matcher with its buffers."""

    def __init__(self, grasps: int, faults: FaultConfig | None = None, seed: int = 0, **options: object) -> None:
        self.readings = stream(grasps, faults, seed)
        self.buffer = TouchBuffer(kept_s=1e6)
        self.clouds = CloudBuffer(60.0, 100.0)
        self.matcher = GraspTouchMatcher(self.buffer, self.clouds, CONFIG, **options)  # type: ignore[arg-type]

    def feel(self) -> None:
        episodes = ContactEpisodes()
        for reading in self.readings:
            self.buffer.add(reading)
            episode = episodes.update(reading.stamp_ns, reading.counts)
            if episode is not None:
                self.matcher.add_episode(episode, 0.0)

    def plan(self, number: int, name: str | None = None) -> int:
        """A cloud and its grasps, half a second before the hand begins to close; gives the stamp."""
        stamp = interval(number).start - SECOND // 2
        self.clouds.add(SeenObjects(stamp, partial(seen, 0.0), 60, f"cloud {number}".encode()), 0.0)
        self.matcher.add_plan(stamp, "camera", [Named(name or f"g-{number}"), Named(f"{name or f'g-{number}'} second")])
        return stamp

    def report(self, number: int, name: str | None = None, when: Interval | None = None) -> None:
        executed = ExecutedGrasp(grasp_id=name or f"g-{number}", interval=when or interval(number), success=True)
        self.matcher.add_executed(executed, 0.0)

    def reasons(self) -> list[str]:
        results = self.matcher.poll(10.0)
        return [r.reason if isinstance(r, RejectedGrasp) else "recorded" for r in results]


def _check_pairs(seed: int) -> None:
    rng = np.random.default_rng(seed)
    count = 20
    world = Session(count, FaultConfig(jitter_s=0.02, skew_s=0.05, drop_share=0.05), seed)
    world.feel()
    known = [number for number in range(count) if rng.random() > 0.2]
    for number in rng.permutation(known):
        world.plan(int(number))
    reported = [int(number) for number in rng.permutation(count) if rng.random() > 0.1]
    for number in reported:
        world.report(number)
    results = world.matcher.poll(10.0)
    linked = [result for result in results if isinstance(result, MatchedGrasp)]
    assert {one.executed.grasp_id for one in linked} <= {f"g-{number}" for number in set(known) & set(reported)}
    assert len(linked) >= 0.9 * len(set(known) & set(reported))
    for one in linked:
        number = int(one.executed.grasp_id.removeprefix("g-"))
        assert one.cloud.data == f"cloud {number}".encode()
        # The nearest wrong touch is 10 counts away in every electrode and 20 in PDC.
        assert np.abs(one.sample.touch.values - level(number)).max() < 5.0
    reasons = [result.reason for result in results if isinstance(result, RejectedGrasp)]
    assert len(results) == len(reported)
    assert reasons.count("grasp_unknown") == len(set(reported) - set(known))


def test_no_pair_is_wrong_however_messages_come() -> None:
    """Jitter of 20 ms, skew of 50 ms, 5 % of the readings lost, clouds and reports lost and in any order."""
    every_case(range(3), _check_pairs)


def test_a_grasp_waits_for_what_is_on_its_way_but_not_forever() -> None:
    world = Session(1)
    world.report(0)
    assert world.matcher.poll(0.5) == []
    world.plan(0)
    assert world.matcher.poll(0.5) == []
    world.feel()
    assert isinstance(world.matcher.poll(0.5)[0], MatchedGrasp)
    late = Session(1)
    late.plan(0)
    late.report(0)
    assert late.matcher.poll(0.9) == []
    assert late.reasons() == ["no_tactile"]


def test_reports_that_are_repeated_unplanned_ambiguous_or_of_a_lost_cloud_are_rejected() -> None:
    world = Session(2)
    world.feel()
    for number in (0, 1):
        world.plan(number)
    world.report(0)
    world.report(0)
    world.report(0, "g-0 second", replace(interval(0), start=interval(0).start + SECOND // 10))
    world.report(1, "never planned")
    world.matcher.add_executed(ExecutedGrasp(grasp_id="g-1", interval=None, success=False), 0.0)
    assert world.reasons() == ["recorded", "told_twice", "overlap", "grasp_unknown", "grasp_failed"]
    world = Session(3)
    world.feel()
    world.plan(0, "same")
    world.plan(1, "same")
    world.report(1, "same")
    stamp = world.plan(2)
    other = SeenObjects(stamp, partial(seen, 1.0), 60, b"another")
    world.clouds.add(other, 0.0)
    world.report(2)
    assert world.reasons() == ["grasp_ambiguous", "cloud_ambiguous"]
    unknown = Session(1)
    unknown.report(0, "nonsense")
    (refused,) = unknown.matcher.poll(10.0)  # who reports it names the grasp once
    assert (refused.grasp_id, "nonsense" in refused.message) == ("nonsense", False)
    again = Session(2)  # planned on two clouds, of which the first is forgotten: the other one is meant
    again.feel()
    forgotten = again.plan(0, "same")
    again.plan(1, "same")
    again.matcher.forget_plan(forgotten)
    again.report(1, "same")
    assert again.reasons() == ["recorded"]
    gone = Session(1)
    gone.feel()
    gone.plan(0)
    gone.clouds.clear()
    gone.report(0)
    assert gone.reasons() == ["cloud_unknown"]
    early = Session(2)  # the grasp began before its cloud was taken
    early.feel()
    early.plan(1)
    early.report(1, when=interval(0))
    assert early.reasons() == ["bad_interval"]


def test_a_label_waits_for_the_report_of_its_grasp_unless_it_has_times_itself() -> None:
    world = Session(1)
    with pytest.raises(PairingError, match="there is no grasp to label: none was planned"):
        world.matcher.add_label(Label(interval=interval(0)), 0.0)
    world.plan(0)
    world.matcher.add_label(Label(object="cup"), 0.0)
    world.feel()
    assert world.matcher.poll(0.5) == []
    world.report(0)
    (one,) = world.matcher.poll(3.0)
    assert isinstance(one, MatchedGrasp)
    assert one.executed.flags == ()
    assert one.label is not None
    with pytest.raises(PairingError, match="is recorded already"):
        world.matcher.add_label(Label(grasp_id="g-0"), 3.0)
    with pytest.raises(PairingError, match="g-9: was not planned"):
        world.matcher.add_label(Label(grasp_id="g-9"), 3.0)
    timed = Session(1)
    timed.feel()
    timed.plan(0)
    timed.matcher.add_label(Label(interval=interval(0)), 0.0)
    assert timed.matcher.add_label(Label(object="cup"), 0.0) == ("g-0", "its touch is being recorded")
    (one,) = timed.matcher.poll(3.0)
    assert isinstance(one, MatchedGrasp)
    assert one.executed.flags == ("labelled_interval",)


def test_a_label_of_a_grasp_that_was_never_executed_is_rejected_at_the_end() -> None:
    idle = Session(1)
    idle.plan(0)
    idle.matcher.add_label(Label(grasp_id="g-0"), 0.0)
    (one,) = idle.matcher.poll(0.0, ending=True)
    assert isinstance(one, RejectedGrasp)
    assert one.reason == "no_contact"
