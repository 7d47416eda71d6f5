# SPDX-License-Identifier: Apache-2.0
"""Execute a simulated grasp repeatedly, with everything that no camera can see redrawn each time.

A model is given the cloud and the planned grasp, but not how deep or hard the hand closes, which part of the pads makes
contact, how far beside the plan the hand lands, and what temperature and noise add. These effects of a sample are drawn
again from the simulator's own streams, and all else, object, pose and cloud, is kept. Attempts that fail (a finger
slips or closes beside the object) are left out, as they are in a dataset.
"""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from foretouch.errors import ConfigError, SimulationError
from foretouch.simulation.effects import EFFECTS
from foretouch.simulation.engine import Engine
from foretouch.simulation.scene import ObjectConfig, SceneConfig
from foretouch.simulation.world import SampleKey
from foretouch.types import Float64

CAUSES: Final = {
    "command": frozenset({"targets"}),
    "posture": frozenset({"posture"}),
    "placement": frozenset({"execution_error"}),
    "sensor": frozenset({"slip", "drift", "noise", "scan_hold"}),
}
"""Hidden causes and the simulated effects that draw them: how far the hand closes; which part of the pads
makes contact; where the hand lands and how exactly it reaches its target; what the sensor adds over time."""

NEW_OBJECT: Final = "new_object"
"""Also unknown of an object that was never touched: its day, and its material, that of any object of the scene."""

_MATERIAL: Final = ("young_pa", "thickness_m", "friction")
_TRIES: Final = 10  # per requested repeat


@dataclass(frozen=True, eq=False)
class Repeats:
    """Repeats of one grasp."""

    touches: Float64  # (n, 50) [counts]
    tares: Float64  # (n, 50) [counts]


class Repeater:
    """Repeats grasps of one scene.

    Args:
        scene: The scene.
        causes: Those of `CAUSES` and `NEW_OBJECT` that are redrawn; the others are those of the sample.

    Raises:
        ConfigError: If the scene has a campaign, in which no moment comes twice.
    """

    def __init__(self, scene: SceneConfig, causes: frozenset[str]) -> None:
        if scene.campaign is not None:
            raise ConfigError("scene: campaign: grasps are repeated at one moment; give a scene without a campaign")
        again = frozenset[str]().union(*(CAUSES[cause] for cause in causes - {NEW_OBJECT}))
        self._new_object = NEW_OBJECT in causes
        if self._new_object:
            again |= {"sessions"}
        effects = [replace(effect, again=effect.name in again) for effect in EFFECTS]
        self._engine = Engine(scene, effects, ("touch", "tare"))

    def repeat(self, slot: int, attempt: int, count: int) -> Repeats:
        """Execute one grasp again.

        Args:
            slot: Slot of the sample.
            attempt: Attempt that made it.
            count: Number of repeats; a grasp that fails too often gives fewer.

        Raises:
            SimulationError: If fewer than two succeed.
        """
        touches: list[Float64] = []
        tares: list[Float64] = []
        for number in range(1, 1 + _TRIES * count):
            if len(touches) == count:
                break
            try:
                state = self._engine.run(
                    SampleKey(self._engine.scene.seed, slot, attempt, number), self._item(slot, number)
                )
            except SimulationError:
                continue
            if state.tare is not None:  # without a campaign each grasp has one
                touches.append(state.touch.vector())
                tares.append(state.tare.vector())
        if len(touches) < 2:
            raise SimulationError(f"slot {slot}: {len(touches)} of {_TRIES * count} repeats succeed", "repeats")
        return Repeats(np.array(touches), np.array(tares))

    def _item(self, slot: int, number: int) -> ObjectConfig:
        """Object of a slot, with the material of another object in each repeat if the object is new."""
        items = self._engine.scene.objects
        item = items[slot % len(items)]
        if not self._new_object:
            return item
        others = [other for other in items if other.rigid == item.rigid]  # these need the same effects
        rng = np.random.default_rng([self._engine.scene.seed, slot, number])
        other = others[int(rng.integers(len(others)))]
        return item.replace(**{name: getattr(other, name) for name in _MATERIAL})
