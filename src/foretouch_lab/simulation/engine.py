# SPDX-License-Identifier: Apache-2.0
"""Runs the effects that a scene calls for, in the order of their list, and measures their time.

Of each object of the scene, those effects run that the scene calls for and whose result leads to an output. The others cost nothing.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

from foretouch.errors import ContactError, ConvergenceError, ForetouchError, GraspError, SimulationError
from foretouch_lab.simulation.campaign import Campaign, object_index
from foretouch_lab.simulation.effect import Effect, Job, SampleState
from foretouch_lab.simulation.scene import SceneConfig
from foretouch_lab.simulation.scene.objects import ObjectConfig
from foretouch_lab.simulation.world import SampleKey, World

# Reasons of failed tries that are not named by the effect.
_REASONS: Final[dict[type[ForetouchError], str]] = {
    ContactError: "contact",
    ConvergenceError: "not_converged",
    GraspError: "no_grasp",
}


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


@dataclass(eq=False)
class Engine:
    """Makes samples of one scene.

    Attributes:
        scene: The scene.
        effects: All effects there are, in the order in which they run.
        outputs: The keys that are asked for.
        timings: By effect, for all that are listed: those that never ran have no calls.
        world: What all samples share.
        chains: Of each object, the effects that run.
    """

    scene: SceneConfig
    effects: Sequence[Effect]
    outputs: tuple[str, ...]
    timings: dict[str, EffectTiming] = field(init=False)
    world: World = field(init=False)
    chains: list[list[Effect]] = field(init=False)

    def __post_init__(self) -> None:
        self.timings = {effect.name: EffectTiming() for effect in self.effects}
        self.world = World.of(self.scene)
        campaign = self.scene.campaign
        self._campaign = Campaign(campaign, self.scene, self.world.fingers) if campaign else None
        self.chains = [self._chain(item) for item in self.scene.objects]

    def _chain(self, item: ObjectConfig) -> list[Effect]:
        """The effects that lead to the outputs for one object, found from the outputs backwards."""
        wanted, chain = set(self.outputs), []
        for effect in reversed(self.effects):
            if not wanted.isdisjoint(effect.writes) and effect.reason(self.scene, item) is not None:
                chain.append(effect)
                wanted.update(effect.reads)
        return chain[::-1]

    def explain(self) -> list[EffectPlan]:
        """Which effects will run and which will not, without running any."""
        plans = []
        for effect in self.effects:
            reasons = [effect.reason(self.scene, item) for item in self.scene.objects]
            ran = [k for k, chain in enumerate(self.chains) if effect in chain]
            reason = ", ".join(dict.fromkeys(reasons[k] or "" for k in ran))
            if not ran:
                reason = "nothing reads it" if any(reasons) else effect.off or f"no {effect.when}"
            plans.append(EffectPlan(effect.name, bool(ran), reason, tuple(self.scene.objects[k].name for k in ran)))
        return plans

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
        for effect in self.chains[index]:
            timing = self.timings[effect.name]
            start = time.thread_time()
            try:
                effect.run(Job(self.scene, item, self.world, key, effect, self._campaign), state)
            except SimulationError:
                raise
            except ForetouchError as err:
                reason = _REASONS.get(type(err), effect.name)
                raise SimulationError(f"{item.name}: {effect.name}: {err}", reason) from err
            finally:
                timing.calls += 1
                timing.seconds += time.thread_time() - start
        return state
