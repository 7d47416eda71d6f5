# SPDX-License-Identifier: Apache-2.0
"""Samples of a scene, in order, on one process or several.

A data set has slots; slot k shows object k modulo their number, or what a campaign has on the table. A slot whose try
fails (GeoGrasp finds no grasp, a finger closes beside the object...) is tried again with other random numbers, each
failure counted by reason. What stands in a slot depends on the scene, the seed and the slot alone, hence not on the
number of workers.
"""

from collections import Counter, deque
from collections.abc import Iterator
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field

import numpy as np

from foretouch.errors import ConfigError, SimulationError
from foretouch.processes import one_thread_each, process_pool
from foretouch.simulation.campaign import object_index
from foretouch.simulation.effect import SampleState
from foretouch.simulation.effects import EFFECTS
from foretouch.simulation.engine import EffectPlan, EffectTiming, Engine, explain
from foretouch.simulation.scene import SceneConfig
from foretouch.simulation.world import SampleKey
from foretouch.types import ELECTRODES, GraspSample

SAMPLE_KEYS = ("cloud", "grasp", "targets", "contacts", "touch", "tare")
"""The keys of the state that every sample is made of."""

_BLOCK = 16  # slots that a worker makes at a time
_AHEAD = 3  # blocks a worker that may wait for the reader


@dataclass(frozen=True)
class Failure:
    """A try that came to nothing."""

    key: SampleKey  # with the scene, makes it fail again: see `replay`
    reason: str  # by which it is counted
    message: str  # what happened


@dataclass(frozen=True, eq=False)
class SimulatedSample:
    """A sample and how to make it again.

    Attributes:
        sample: The sample; its id is `<object>/<slot>`, and `extra` holds targets and contacts of both fingers.
        key: Which one it is.
        failures: The tries before it.
    """

    sample: GraspSample
    key: SampleKey
    failures: tuple[Failure, ...] = ()


@dataclass
class Simulation:
    """A run over a scene; iterate `samples` once.

    Attributes:
        scene: The scene.
        timings: By effect, over all tries so far.
        failures: Tries that came to nothing, so far.
    """

    scene: SceneConfig
    timings: dict[str, EffectTiming] = field(default_factory=lambda: {e.name: EffectTiming() for e in EFFECTS})
    failures: list[Failure] = field(default_factory=list)

    @property
    def failures_by_reason(self) -> dict[str, int]:
        """How many tries came to nothing, by reason, the most frequent first."""
        return dict(Counter(failure.reason for failure in self.failures).most_common())

    def samples(self, count: int, workers: int = 1) -> Iterator[SimulatedSample]:
        """The first `count` samples, in the order of their slots.

        Args:
            count: How many.
            workers: Processes; 1 makes all in this one.

        Raises:
            ConfigError: If the scene is a campaign of fewer grasps.
            SimulationError: If a slot fails `scene.max_attempts` times.
        """
        campaign = self.scene.campaign
        if campaign is not None and count > campaign.size:
            raise ConfigError(
                f"campaign: {count} grasps exceed its {campaign.size} ({len(campaign.days)} sessions of {campaign.objects} "
                f"objects, {campaign.grasps} grasps each)"
            )
        blocks = (range(start, min(start + _BLOCK, count)) for start in range(0, count, _BLOCK))
        if workers == 1:
            maker = _Maker(self.scene)
            results: Iterator[_Block] = (maker.block(slots) for slots in blocks)
        else:
            results = _spread(self.scene, blocks, workers)
        for samples, timings, broken in results:
            for name, timing in timings.items():
                self.timings[name].add(timing)
            for sample in samples:
                self.failures.extend(sample.failures)
                yield sample
            if broken is not None:
                self.failures.extend(broken)
                raise _given_up(broken)


def explain_scene(scene: SceneConfig) -> list[EffectPlan]:
    """Which effects will run and which will not, without running any."""
    return explain(scene, EFFECTS, _keys(scene))


def replay(scene: SceneConfig, key: SampleKey) -> SampleState:
    """Make one try again, with all that was known along the way.

    Raises:
        SimulationError: As it did.
    """
    return Engine(scene, EFFECTS, _keys(scene)).run(key)


def _keys(scene: SceneConfig) -> tuple[str, ...]:
    """Of the state that a sample of this scene is made of."""
    return SAMPLE_KEYS if scene.campaign is None else (*SAMPLE_KEYS, "moment")


_Block = tuple[list[SimulatedSample], dict[str, EffectTiming], "list[Failure] | None"]


class _Maker:
    """Makes blocks of slots; one in each process."""

    def __init__(self, scene: SceneConfig) -> None:
        self._scene = scene
        self._engine = Engine(scene, EFFECTS, _keys(scene))

    def block(self, slots: range) -> _Block:
        """The samples of some slots, the time they took and, where one is given up, its failures."""
        from threadpoolctl import threadpool_limits

        self._engine.timings.update({effect.name: EffectTiming() for effect in EFFECTS})
        samples: list[SimulatedSample] = []
        with threadpool_limits(1):  # sums of threaded BLAS depend on the number of threads
            for slot in slots:
                made = self._slot(slot)
                if isinstance(made, list):
                    return samples, self._ran(), made
                samples.append(made)
        return samples, self._ran(), None

    def _slot(self, slot: int) -> SimulatedSample | list[Failure]:
        failures: list[Failure] = []
        for attempt in range(self._scene.max_attempts):
            key = SampleKey(self._scene.seed, slot, attempt)
            try:
                state = self._engine.run(key)
            except SimulationError as err:
                if err.reason == "effect":
                    raise  # a mistake in the program, not in the sample
                failures.append(Failure(key, err.reason, str(err)))
            else:
                return SimulatedSample(_sample(self._scene, key, state), key, tuple(failures))
        return failures

    def _ran(self) -> dict[str, EffectTiming]:
        return {name: timing for name, timing in self._engine.timings.items() if timing.calls}


def _sample(scene: SceneConfig, key: SampleKey, state: SampleState) -> GraspSample:
    item = scene.objects[object_index(scene, key.slot)]
    extra = {"seed": float(key.seed), "slot": float(key.slot), "attempt": float(key.attempt)}
    for finger, target, contact in zip(("th", "mf"), state.targets, state.contacts, strict=True):
        extra[f"target_{finger}"] = float(target)
        extra[f"force_{finger}_n"] = contact.force_n
        extra[f"depth_{finger}_m"] = float(contact.depth_m)
        extra[f"area_{finger}_m2"] = float(contact.area_m2)
    if scene.campaign is not None:
        extra |= _course(state)
    return GraspSample(
        id=f"{item.name}/{key.slot:06d}",
        object=item.name,
        cloud=state.cloud,
        grasp=state.grasp,
        touch=state.touch,
        tare=state.tare,
        stamp_ns=0 if scene.campaign is None else state.moment.stamp_ns,
        extra=extra,
    )


def _course(state: SampleState) -> dict[str, float]:
    """Where in the campaign a sample is, and its true rest levels: PDC, and the mean of the electrodes [counts]."""
    moment = state.moment
    course = {"session": float(moment.session), "visit": float(moment.visit), "powered_s": moment.powered_s}
    level = state.level[0] if hasattr(state, "level") else np.zeros((2, 1 + ELECTRODES))
    for finger, sensor, moved in zip(("th", "mf"), state.sensors, level, strict=True):
        course[f"rest_pdc_{finger}"] = float(sensor.pdc_rest + moved[0])
        course[f"rest_e_{finger}"] = float(np.mean(sensor.electrode_rest + moved[1:]))
    return course


def _given_up(failures: list[Failure]) -> SimulationError:
    last = failures[-1]
    reasons = ", ".join(f"{n} {reason}" for reason, n in Counter(f.reason for f in failures).items())
    return SimulationError(
        f"slot {last.key.slot}: given up after {len(failures)} attempts ({reasons}); the last: {last.message}",
        last.reason,
    )


_maker: _Maker | None = None  # of a worker process


def _start_worker(scene: SceneConfig) -> None:
    global _maker  # noqa: PLW0603  # a worker process has one scene all its life
    _maker = _Maker(scene)


def _work(slots: range) -> _Block:
    if _maker is None:
        raise SimulationError("worker: has no scene", "effect")
    return _maker.block(slots)


def _spread(scene: SceneConfig, blocks: Iterator[range], workers: int) -> Iterator[_Block]:
    """Blocks in order from several processes, a few made ahead of the reader."""
    with one_thread_each(), process_pool(workers, _start_worker, (scene,)) as pool:
        pending: deque[Future[_Block]] = deque()
        try:
            for slots in blocks:
                pending.append(pool.submit(_work, slots))
                if len(pending) >= workers * _AHEAD:
                    yield pending.popleft().result()
            while pending:
                yield pending.popleft().result()
        except BrokenProcessPool as err:
            raise SimulationError("a worker process died; with --workers 1 the cause can be seen", "worker") from err
