# SPDX-License-Identifier: Apache-2.0
"""The same simulated grasp over and over, with what no camera can see drawn anew each time.

A model is told the cloud and the planned grasp. It is not told how deep or hard the hand closes, with which place of its
pads, how far beside the plan it lands, and what temperature and noise add. So of one sample these are drawn again from
the simulator's own streams, and all else, object, pose and cloud, is kept. Tries that come to nothing (a finger slips or
closes beside the object) are left out, as they are in a data set.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from foretouch.errors import SimulationError
from foretouch.simulation.engine import Engine
from foretouch.simulation.scene import ObjectConfig, SceneConfig
from foretouch.simulation.steps import EFFECTS
from foretouch.simulation.streams import SampleKey
from foretouch.types import Float64

__all__ = ["CAUSES", "STRANGER", "Repeater", "Repeats"]

CAUSES: Final = {
    "command": frozenset({"targets"}),
    "posture": frozenset({"posture"}),
    "placement": frozenset({"execution_error"}),
    "sensor": frozenset({"slip", "drift", "noise", "scan_hold"}),
}
"""What is hidden, by the effects that draw it: how far the hand closes; with which place of the pads; where it lands and
how exactly it reaches its target; what the sensor adds over time."""

STRANGER: Final = "stranger"
"""Hidden as well of an object that was never touched: its day, and its material, for which each repeat takes that of
any object of the scene."""

_MATERIAL: Final = ("young_pa", "poisson", "thickness_m", "friction")
_TRIES: Final = 10  # for each repeat that is wanted


@dataclass(frozen=True, eq=False)
class Repeats:
    """Repeats of one grasp.

    Attributes:
        touches: (n, 50) float64 [counts].
        tares: (n, 50) float64 [counts].
    """

    touches: Float64
    tares: Float64


class Repeater:
    """Repeats grasps of one scene.

    Args:
        scene: The scene.
        causes: Of `CAUSES` and `STRANGER`, those to draw anew; the others stay as they were in the sample.
    """

    def __init__(self, scene: SceneConfig, causes: frozenset[str]) -> None:
        again = frozenset[str]().union(*(CAUSES[cause] for cause in causes - {STRANGER}))
        self._strange = STRANGER in causes
        if self._strange:
            again |= {"sessions"}
        effects = [replace(effect, again=effect.name in again) for effect in EFFECTS]
        self._engine = Engine(scene, effects, ("touch", "tare"))

    def repeat(self, slot: int, attempt: int, count: int) -> Repeats:
        """Execute one grasp again.

        Args:
            slot: Of the sample.
            attempt: Of the try that made it.
            count: How many repeats are wanted; a grasp that fails too often gives fewer.

        Raises:
            SimulationError: If not even two succeed.
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
            except SimulationError as err:
                if err.reason == "effect":
                    raise  # a mistake in the program, not in the grasp
                continue
            touches.append(state.touch.vector())
            tares.append(state.tare.vector())
        if len(touches) < 2:
            raise SimulationError(f"slot {slot}: {len(touches)} of {_TRIES * count} repeats succeed", "repeats")
        return Repeats(np.array(touches), np.array(tares))

    def _item(self, slot: int, number: int) -> ObjectConfig:
        """The object of a slot; of a stranger, as one repeat takes it."""
        items = self._engine.scene.objects
        item = items[slot % len(items)]
        if not self._strange:
            return item
        others = [other for other in items if other.rigid == item.rigid]  # these call for the same effects
        rng = np.random.default_rng([self._engine.scene.seed, slot, number])
        other = others[int(rng.integers(len(others)))]
        return item.replace(**{name: getattr(other, name) for name in _MATERIAL})
