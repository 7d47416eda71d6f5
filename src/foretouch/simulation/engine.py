# SPDX-License-Identifier: Apache-2.0
"""Runs the effects that a scene calls for, in the order of their list, and measures their time.

Of each object of the scene, those effects run that the scene calls for and whose result leads to an output. The others cost nothing.
"""

import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

from foretouch.errors import ForetouchError, SimulationError
from foretouch.simulation.campaign import Campaign, object_index
from foretouch.simulation.effect import Effect, Job, SampleState
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


def plan_chain(
    effects: Sequence[Effect], scene: SceneConfig, item: ObjectConfig, outputs: Iterable[str]
) -> list[Effect]:
    """The effects that make `outputs` for one object, in the order of the list, from the outputs backwards."""
    wanted, chain = set(outputs), []
    for effect in reversed(effects):
        if not wanted.isdisjoint(effect.writes) and effect.reason(scene, item) is not None:
            chain.append(effect)
            wanted.update(effect.reads)
    return chain[::-1]


def explain(scene: SceneConfig, effects: Sequence[Effect], outputs: Iterable[str]) -> list[EffectPlan]:
    """Which effects will run and which will not, without running any."""
    outputs = tuple(outputs)
    chains = [plan_chain(effects, scene, item, outputs) for item in scene.objects]
    plans = []
    for effect in effects:
        items = [item for item, chain in zip(scene.objects, chains, strict=True) if effect in chain]
        if items:
            reasons = dict.fromkeys(effect.reason(scene, item) or "" for item in items)
            plans.append(EffectPlan(effect.name, True, ", ".join(reasons), tuple(item.name for item in items)))
            continue
        called_for = any(effect.reason(scene, item) is not None for item in scene.objects)
        plans.append(
            EffectPlan(effect.name, False, "nothing reads it" if called_for else effect.off or f"no {effect.when}")
        )
    return plans


@dataclass(eq=False)
class Engine:
    """Makes samples of one scene.

    Attributes:
        scene: The scene.
        effects: All effects there are, in the order in which they run.
        outputs: The keys that are asked for.
        timings: By effect, for all that are listed: those that never ran have no calls.
        world: What all samples share.
    """

    scene: SceneConfig
    effects: Sequence[Effect]
    outputs: tuple[str, ...]
    timings: dict[str, EffectTiming] = field(init=False)
    world: World = field(init=False)

    def __post_init__(self) -> None:
        self.timings = {effect.name: EffectTiming() for effect in self.effects}
        self.world = World.of(self.scene)
        campaign = self.scene.campaign
        self._campaign = Campaign(campaign, self.scene, self.world.fingers) if campaign else None
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
                effect.run(Job(self.scene, item, self.world, key, effect, self._campaign), state)
            except SimulationError:
                raise
            except ForetouchError as err:
                raise SimulationError(f"{item.name}: {effect.name}: {err}", effect.name) from err
            finally:
                timing.calls += 1
                timing.seconds += time.thread_time() - start
        return state
