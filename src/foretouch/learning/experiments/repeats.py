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
from foretouch.simulation.scene import SceneConfig
from foretouch.simulation.steps import EFFECTS
from foretouch.simulation.streams import SampleKey
from foretouch.types import Float64

__all__ = ["CAUSES", "Repeater", "Repeats"]

CAUSES: Final = {
    "command": frozenset({"targets"}),
    "posture": frozenset({"posture"}),
    "placement": frozenset({"execution_error"}),
    "sensor": frozenset({"slip", "drift", "noise", "scan_hold"}),
}
"""What is hidden, by the effects that draw it: how far the hand closes; with which place of the pads; where it lands and
how exactly it reaches its target; what the sensor adds over time."""

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
        causes: Of `CAUSES`, those to draw anew; the others stay as they were in the sample.
    """

    def __init__(self, scene: SceneConfig, causes: frozenset[str]) -> None:
        again = frozenset[str]().union(*(CAUSES[cause] for cause in causes))
        effects = [replace(effect, again=effect.name in again) for effect in EFFECTS]
        self._engine = Engine(scene, effects, ("touch", "tare"))
        self._seed = scene.seed

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
                state = self._engine.run(SampleKey(self._seed, slot, attempt, number))
            except SimulationError as err:
                if err.reason == "effect":
                    raise  # a mistake in the program, not in the grasp
                continue
            touches.append(state.touch.vector())
            tares.append(state.tare.vector())
        if len(touches) < 2:
            raise SimulationError(f"slot {slot}: {len(touches)} of {_TRIES * count} repeats succeed", "repeats")
        return Repeats(np.array(touches), np.array(tares))
