# SPDX-License-Identifier: Apache-2.0
"""Runs the effects that a scene calls for, in the order that their declarations allow, and keeps count.

For each object of the scene a chain is made once: from the outputs backwards, the effects that make or change
what is read, so far as the scene calls for them. What is not in the chain costs nothing.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from graphlib import CycleError, TopologicalSorter

from foretouch.errors import ForetouchError, SimulationError
from foretouch.simulation.campaign import Campaign, object_index
from foretouch.simulation.effect import Effect, Job, SampleState, guarded
from foretouch.simulation.scene import ObjectConfig, SceneConfig
from foretouch.simulation.world import SampleKey, World


@dataclass(frozen=True)
class EffectPlan:
    """Whether an effect will run in a scene, and why."""

    name: str  # of the effect
    runs: bool  # whether it runs with any of the objects
    reason: str  # the field of the scene that calls for it, or the one whose absence leaves it out
    objects: tuple[str, ...] = ()  # the objects it runs with


@dataclass
class EffectTiming:
    """How often an effect ran and how long in all, by the processor time of its thread [s]."""

    calls: int = 0
    seconds: float = 0.0

    def add(self, other: EffectTiming) -> None:
        """Add what another worker counted."""
        self.calls += other.calls
        self.seconds += other.seconds


def plan_chain(
    effects: Sequence[Effect], scene: SceneConfig, item: ObjectConfig, outputs: Iterable[str]
) -> list[Effect]:
    """The effects that make `outputs` for one object, in the order in which they run.

    Raises:
        SimulationError: If a key has no maker or two of them, or the declarations go round in a circle.
    """
    wanted = [effect for effect in effects if effect.needed(scene, item) is not None]
    makers = _makers(wanted)
    changers: dict[str, list[Effect]] = {}
    for effect in wanted:
        for key in effect.modifies:
            changers.setdefault(key, []).append(effect)
    chosen: dict[str, Effect] = {}
    open_keys, seen = list(outputs), set[str]()
    while open_keys:
        key = open_keys.pop()
        if key in seen:
            continue
        seen.add(key)
        if key not in makers:
            raise SimulationError(f"{item.name}: no effect of this scene makes {key}", "effect")
        for effect in (makers[key], *changers.get(key, [])):
            if effect.name not in chosen:
                chosen[effect.name] = effect
                open_keys.extend(effect.reads | effect.modifies | effect.writes)
    return _in_order([effect for effect in wanted if effect.name in chosen], makers)


def explain(scene: SceneConfig, effects: Sequence[Effect], outputs: Iterable[str]) -> list[EffectPlan]:
    """Which effects will run and which will not, without running any."""
    outputs = tuple(outputs)
    chains = [(item, {e.name for e in plan_chain(effects, scene, item, outputs)}) for item in scene.objects]
    plans = []
    for effect in effects:
        items = [item for item, names in chains if effect.name in names]
        reasons = dict.fromkeys(effect.needed(scene, item) or "" for item in items)
        if items:
            plans.append(EffectPlan(effect.name, True, ", ".join(reasons), tuple(item.name for item in items)))
            continue
        called_for = any(effect.needed(scene, item) for item in scene.objects)
        plans.append(EffectPlan(effect.name, False, "nothing reads it" if called_for else effect.off))
    return plans


@dataclass(eq=False)
class Engine:
    """Makes samples of one scene.

    Attributes:
        scene: The scene.
        effects: All effects there are.
        outputs: The keys that are asked for.
        timings: By effect, for all that are listed: those that never ran have no calls.
    """

    scene: SceneConfig
    effects: Sequence[Effect]
    outputs: tuple[str, ...]
    timings: dict[str, EffectTiming] = field(init=False)
    _world: World = field(init=False)
    _campaign: Campaign | None = field(init=False)
    _chains: list[list[Effect]] = field(init=False)

    def __post_init__(self) -> None:
        self.timings = {effect.name: EffectTiming() for effect in self.effects}
        self._world = World.of(self.scene)
        self._campaign = Campaign.of(self.scene, self._world)
        self._chains = [plan_chain(self.effects, self.scene, item, self.outputs) for item in self.scene.objects]

    def run(self, key: SampleKey, item: ObjectConfig | None = None) -> SampleState:
        """Make one sample.

        Args:
            key: Which one.
            item: In place of that object: one that calls for the same effects, such as itself of another material.

        Raises:
            SimulationError: If an effect refuses; `reason` names the kind.
        """
        index = object_index(self.scene, key.slot)
        item = self.scene.objects[index] if item is None else item
        state = SampleState()
        for effect in self._chains[index]:
            timing = self.timings[effect.name]
            start = time.thread_time()
            try:
                job = Job(self.scene, item, self._world, key, effect.name, effect.again, self._campaign)
                effect.run(job, guarded(state, effect))
            except SimulationError:
                raise
            except ForetouchError as err:
                raise SimulationError(f"{item.name}: {effect.name}: {err}", effect.name) from err
            finally:
                timing.calls += 1
                timing.seconds += time.thread_time() - start
        return state


def _makers(effects: Sequence[Effect]) -> dict[str, Effect]:
    makers: dict[str, Effect] = {}
    for effect in effects:
        for key in effect.writes:
            if key in makers:
                raise SimulationError(f"{key}: is made by {makers[key].name} and by {effect.name}", "effect")
            makers[key] = effect
    return makers


def _in_order(effects: list[Effect], makers: dict[str, Effect]) -> list[Effect]:
    """Makers before changers before readers; else in the order of the list."""
    rank = {effect.name: k for k, effect in enumerate(effects)}
    by_name = {effect.name: effect for effect in effects}
    changers: dict[str, list[str]] = {}
    for effect in effects:
        for key in effect.modifies:
            changers.setdefault(key, []).append(effect.name)
    before: dict[str, set[str]] = {effect.name: set() for effect in effects}
    for effect in effects:
        for key in effect.reads:
            before[effect.name] |= {makers[key].name, *changers.get(key, [])} - {effect.name}
        for key in effect.modifies:
            chain = changers[key]
            before[effect.name] |= {makers[key].name, *chain[: chain.index(effect.name)]} - {effect.name}
    sorter = TopologicalSorter(before)
    try:
        sorter.prepare()
    except CycleError as err:
        raise SimulationError(f"effects: {' needs '.join(err.args[1])}: a circle", "effect") from err
    order: list[Effect] = []
    while sorter.is_active():
        ready = sorted(sorter.get_ready(), key=rank.__getitem__)
        order += [by_name[name] for name in ready]
        sorter.done(*ready)
    return order
