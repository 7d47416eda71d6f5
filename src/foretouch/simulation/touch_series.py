# SPDX-License-Identifier: Apache-2.0
"""What the fingertips of a simulated hand send while a grasp goes by: rest, closing, hold, release."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from foretouch.simulation.engine import Engine
from foretouch.simulation.fingertip import quantise
from foretouch.simulation.scene import SceneConfig
from foretouch.simulation.steps import EFFECTS
from foretouch.simulation.streams import SampleKey
from foretouch.types import Float64, Grasp

__all__ = ["PHASES", "TouchSeries", "TouchSeriesMaker"]

PHASES: Final = ("rest", "closing", "hold", "opening", "released")


@dataclass(frozen=True, eq=False)
class TouchSeries:
    """The messages of one grasp.

    Attributes:
        times_s: (T,) float64 since the first message [s].
        phases: (T,) int64, index into `PHASES`.
        pdc: (T, 2) int64 [counts], thumb and middle finger.
        electrodes: (T, 2, 24) int64 [counts].
        grasp: The grasp, in the camera frame.
        touch_row: The message that a data set takes as the touch.
    """

    times_s: Float64
    phases: npt.NDArray[np.int64]
    pdc: npt.NDArray[np.int64]
    electrodes: npt.NDArray[np.int64]
    grasp: Grasp
    touch_row: int


class TouchSeriesMaker:
    """Makes the messages of the grasps of a scene.

    Args:
        scene: The scene; without a timeline it gets the default one.
    """

    def __init__(self, scene: SceneConfig) -> None:
        self.scene = scene if scene.fingers.timeline is not None else scene.updated({"fingers": {"timeline": {}}})
        self._engine = Engine(self.scene, EFFECTS, ("series", "times", "load", "hold_row", "grasp"))

    def series(self, slot: int, attempt: int = 0) -> TouchSeries:
        """The messages of one grasp; with a timeline in the scene, those that sample `slot` was read from.

        Raises:
            SimulationError: If the grasp fails.
        """
        state = self._engine.run(SampleKey(self.scene.seed, slot, attempt))
        pdc, electrodes = quantise(self.scene.fingers.fingertip, state.series[..., 0], state.series[..., 1:])
        return TouchSeries(state.times, _phases(state.load), pdc, electrodes, state.grasp, state.hold_row)


def _phases(load: Float64) -> npt.NDArray[np.int64]:
    touched = np.flatnonzero(load > 0.0)
    full = np.flatnonzero(load == 1.0)
    row = np.arange(len(load))
    begins = (touched[0], full[0], full[-1] + 1, touched[-1] + 1)
    return np.asarray(sum((row >= begin).astype(np.int64) for begin in begins), np.int64)
