# SPDX-License-Identifier: Apache-2.0
"""What all samples of a scene share (camera, fingers), and the random streams of each sample.

Each effect of each sample draws from a random stream of its own, so that adding an effect, or drawing more in one,
changes the numbers of no other effect, and a sample can be generated again alone on any worker.
"""

import hashlib
from dataclasses import dataclass
from functools import lru_cache
from typing import Self

import numpy as np

from foretouch.tactile.channels import BIOTAC
from foretouch.types import Float64, Plane
from foretouch.types.channels import Channels
from foretouch_lab.simulation.fingertip import Finger, draw_finger
from foretouch_lab.simulation.scene import SceneConfig
from foretouch_lab.simulation.taxels import TaxelArray, TaxelConfig
from foretouch_lab.simulation.view import CameraView

CAMERA_FRAME = "camera_depth_optical_frame"


@dataclass(frozen=True)
class SampleKey:
    """Which sample: with the scene it decides every number."""

    seed: int  # of the scene
    slot: int  # place of the sample in the data set, from 0
    attempt: int = 0  # how many tries at this place have failed before, from 0
    repeat: int = 0  # how often the same grasp of the same object was executed before, from 0

    def stream(self, name: str, *, again: bool = False) -> np.random.Generator:
        """The stream of one effect in this sample.

        Args:
            name: Of the effect.
            again: Whether a repeat of the grasp draws other numbers.
        """
        words = (self.seed, *_words(name), self.slot, self.attempt)
        if again and self.repeat:
            words = (*words, self.repeat)
        return np.random.Generator(np.random.PCG64(np.random.SeedSequence(words)))


@lru_cache(maxsize=256)
def _words(name: str) -> tuple[int, ...]:
    digest = hashlib.sha256(name.encode()).digest()
    return tuple(int.from_bytes(digest[i : i + 4], "little") for i in range(0, 16, 4))


@dataclass(frozen=True, eq=False)
class World:
    """The parts of a scene that never move."""

    view: CameraView  # the camera
    rays: Float64  # (H, W, 3) float64, ray of each pixel in the world, one metre deep along the optical axis
    plane: Plane  # the table top in the camera frame, its normal towards the camera
    fingers: tuple[Finger, Finger]  # thumb and middle finger of the scene's hand, whatever its seed
    array: TaxelArray | None  # of the same hand, in their place; None for the BioTac SP

    @classmethod
    def of(cls, scene: SceneConfig) -> Self:
        """From a scene."""
        view = scene.camera.view()
        plane = Plane.from_coefficients(view.table_plane())
        hand = SampleKey(scene.fingers.hand, 0).stream("fingers of the scene")
        fingers = draw_finger(scene.fingers.thumb, hand), draw_finger(scene.fingers.middle, hand)
        sensor, stream = scene.fingers.taxel_sensor(), SampleKey(scene.fingers.hand, 0).stream("taxels of the scene")
        taxels, pad = scene.fingers.taxels or TaxelConfig(), scene.fingers.pad
        array = None if sensor is None else TaxelArray.of(sensor, taxels, pad, stream)
        return cls(view, view.directions(), plane, fingers, array)

    def channels(self) -> Channels:
        """What the values of a touch are."""
        return BIOTAC if self.array is None else self.array.sensor.channels
