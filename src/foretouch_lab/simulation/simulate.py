# SPDX-License-Identifier: Apache-2.0
"""Samples of a scene, in order, on one process or several.

A data set has slots; slot k shows object k modulo their number, or what a campaign has on the table. A slot whose try
fails (GeoGrasp finds no grasp, a finger closes beside the object...) is tried again with other random numbers, each
failure counted by reason. What stands in a slot depends on the scene, the seed and the slot alone, hence not on the
number of workers.
"""

from collections import Counter, defaultdict, deque
from collections.abc import Iterator, Sequence
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial

import numpy as np

from foretouch.base.processes import process_pool
from foretouch.errors import ConfigError, SimulationError
from foretouch.tactile.messages.biotac import FINGERS, OTHERS
from foretouch.types import Sample
from foretouch_lab.simulation.effects import EFFECTS
from foretouch_lab.simulation.engine import EffectPlan, Engine, SampleState
from foretouch_lab.simulation.fingertip import quantise
from foretouch_lab.simulation.scene import SceneConfig
from foretouch_lab.simulation.world import SampleKey, object_index

_BLOCK = 16  # slots that a worker makes at a time
_AHEAD = 3  # blocks a worker that may wait for the reader


@dataclass(frozen=True)
class Failure:
    """A try that came to nothing."""

    key: SampleKey  # with the scene, makes it fail again
    reason: str  # by which it is counted
    message: str  # what happened


@dataclass
class Simulation:
    """A run over a scene; iterate `samples` once."""

    scene: SceneConfig  # the scene
    calls: Counter[str] = field(default_factory=Counter)  # how often each effect ran so far
    seconds: defaultdict[str, float] = field(default_factory=lambda: defaultdict(float))  # and how long in all [s]
    failures: list[Failure] = field(default_factory=list)  # tries that came to nothing, so far

    @property
    def failures_by_reason(self) -> dict[str, int]:
        """How many tries came to nothing, by reason, the most frequent first."""
        return dict(Counter(failure.reason for failure in self.failures).most_common())

    def samples(self, count: int, workers: int = 1) -> Iterator[Sample]:
        """Iterate over the first samples, in the order of their slots.

        The id of a sample is `<object>/<slot>`. Its `extra` holds the slot and the attempt that made it, targets and
        contacts of both fingers, and PAC, TAC and TDC where the scene calls for them. Where a campaign repeats a grasp,
        slot and attempt name the grasp that is repeated, and `repeat` is above 0.

        Args:
            count: How many.
            workers: Processes; 1 makes all in this one.

        Raises:
            ConfigError: If the scene is a campaign of fewer grasps.
            SimulationError: If a slot fails `scene.max_attempts` times.
        """
        if self.scene.campaign is not None and count > self.scene.campaign.size:
            raise ConfigError(f"campaign: {count} grasps exceed its {self.scene.campaign.size}")
        blocks = (range(start, min(start + _BLOCK, count)) for start in range(0, count, _BLOCK))
        made_here = map(partial(_make_block, self.scene), blocks)
        results = made_here if workers == 1 else _spread(self.scene, blocks, workers)
        for samples, calls, seconds, failures, given_up in results:
            self.calls.update(calls)
            for name, spent in seconds.items():
                self.seconds[name] += spent
            self.failures.extend(failures)
            yield from samples
            if given_up:
                raise _given_up(failures[-self.scene.max_attempts :])


def explain_scene(scene: SceneConfig) -> list[EffectPlan]:
    """Return which effects will run and which will not, without running any."""
    return _engine_of(scene).explain()


@lru_cache(maxsize=1)  # a worker process has one scene all its life
def _engine_of(scene: SceneConfig) -> Engine:
    return Engine(scene, EFFECTS)


# Samples, calls and time by effect, failures, and whether they end with a slot that is given up.
_Block = tuple[list[Sample], Counter[str], dict[str, float], list[Failure], bool]


def _make_block(scene: SceneConfig, slots: range) -> _Block:
    from threadpoolctl import threadpool_limits

    engine = _engine_of(scene)
    engine.calls, engine.seconds = Counter(), defaultdict(float)
    samples: list[Sample] = []
    failures: list[Failure] = []
    with threadpool_limits(1):  # sums of threaded BLAS depend on the number of threads
        for slot in slots:
            made, failed = _first_success(engine, _tries(engine, slot))
            failures += failed
            if made is None:
                return samples, engine.calls, engine.seconds, failures, True
            samples.append(_sample(engine, slot, *made))
    return samples, engine.calls, engine.seconds, failures, False


def _tries(engine: Engine, slot: int) -> list[SampleKey]:
    """Return what is tried in a slot, in this order."""
    scene, attempts = engine.scene, range(engine.scene.max_attempts)
    if scene.campaign is not None and scene.campaign.repeats(slot):
        made, _ = _first_success(engine, _tries(engine, slot - 1))
        if made is not None:
            return [replace(made[0], repeat=1 + attempt) for attempt in attempts]
    return [SampleKey(scene.seed, slot, attempt) for attempt in attempts]


def _first_success(
    engine: Engine, tries: Sequence[SampleKey]
) -> tuple[tuple[SampleKey, SampleState] | None, list[Failure]]:
    failures: list[Failure] = []
    for key in tries:
        try:
            return (key, engine.run(key)), failures
        except SimulationError as err:
            failures.append(Failure(key, err.reason, str(err)))
    return None, failures


def _sample(engine: Engine, slot: int, key: SampleKey, state: SampleState) -> Sample:
    scene = engine.scene
    item = scene.objects[object_index(scene, key.slot)]
    extra = {"seed": float(key.seed), "slot": float(key.slot), "attempt": float(key.attempt)}
    if key.repeat:
        extra["repeat"] = float(key.repeat)
    fingers = (name.lower() for name in state.touch.channels.fingers)
    for finger, contact in zip(fingers, state.contacts, strict=True):
        extra[f"target_{finger}"] = state.target
        extra[f"force_{finger}_n"] = contact.force_n
        extra[f"depth_{finger}_m"] = float(contact.depth_m)
        extra[f"area_{finger}_m2"] = float(contact.area_m2)
    if scene.campaign is not None:
        extra |= _campaign_values(state)
    return Sample(
        id=f"{item.name}/{slot:06d}",
        object=item.name,
        cloud=state.cloud,
        table=engine.world.plane,
        grasp=state.grasp,
        touch=state.touch,
        tare=state.tare,
        stamp_ns=0 if scene.campaign is None else state.campaign_time.stamp_ns,
        extra=extra | _other_values(state),
    )


def _campaign_values(state: SampleState) -> dict[str, float]:
    """Return where in the campaign a sample is, and its true rest levels: PDC, and the mean of the electrodes [counts]."""
    now = state.campaign_time
    values = {"session": float(now.session), "visit": float(now.visit), "powered_s": now.powered_s}
    for finger, sensor, moved in zip(("th", "mf"), state.sensors, state.level[0], strict=True):
        values[f"rest_pdc_{finger}"] = float(sensor.pdc_rest + moved[0])
        values[f"rest_e_{finger}"] = float(np.mean(sensor.electrode_rest + moved[1:]))
    return values


def _other_values(state: SampleState) -> dict[str, float]:
    """Return PAC, TAC and TDC in contact as far as they are simulated, and with `tare_` the same of the tare [counts]."""
    rows = {"": state.others[state.hold_row]}
    if state.tare is not None:
        rows["tare_"] = np.median(state.others[: int(np.argmax(state.load > 0.0))], axis=0)
    simulated = np.flatnonzero(state.others.any(axis=(0, 1)))
    return {
        f"{prefix}{OTHERS[k]}_{finger}": float(counts[k])
        for prefix, row in rows.items()
        for finger, counts in zip(FINGERS, quantise(row), strict=True)
        for k in simulated
    }


def _given_up(failures: list[Failure]) -> SimulationError:
    last = failures[-1]
    reasons = ", ".join(f"{n} {reason}" for reason, n in Counter(f.reason for f in failures).items())
    return SimulationError(
        f"slot {last.key.slot}: given up after {len(failures)} attempts ({reasons}); the last: {last.message}",
        last.reason,
    )


def _spread(scene: SceneConfig, blocks: Iterator[range], workers: int) -> Iterator[_Block]:
    """Iterate over blocks in order from several processes, a few made ahead of the reader."""
    with process_pool(workers) as pool:
        pending: deque[Future[_Block]] = deque()
        try:
            for slots in blocks:
                pending.append(pool.submit(_make_block, scene, slots))
                if len(pending) >= workers * _AHEAD:
                    yield pending.popleft().result()
            while pending:
                yield pending.popleft().result()
        except BrokenProcessPool as err:
            raise SimulationError("a worker process died; with --workers 1 the cause can be seen", "worker") from err
