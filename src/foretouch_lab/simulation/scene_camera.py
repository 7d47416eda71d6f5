# SPDX-License-Identifier: Apache-2.0
"""A scene as a camera: whole images of its samples, fed to librealsense's software device.

From there on a real camera runs the same code.
"""

import logging
import time
from collections.abc import Callable

import numpy as np

from foretouch.camera.config import ScheduleConfig
from foretouch.errors import SimulationError
from foretouch.types import Float64, Int32, UInt8
from foretouch_lab.simulation.depth_scene import FIRST_OBJECT, TABLE, RenderedFrame, to_millimetres
from foretouch_lab.simulation.effects import view
from foretouch_lab.simulation.engine import Engine
from foretouch_lab.simulation.scene import SceneConfig
from foretouch_lab.simulation.world import SampleKey, object_index

_GREY = np.array([[60, 60, 66], [150, 140, 125], [196, 140, 90]], np.float64)  # floor, table, and what has no colour
_LOG = logging.getLogger(__name__)
_MS_NS = 1_000_000
_VIEWS = 4  # of one sample, each with independent noise; rendering takes most of a core


class FrameMaker:
    """Makes images of a scene; slot k shows the scene of sample k, with independent camera noise.

    Args:
        scene: The scene. Effects of hand and fingers do not run.
    """

    def __init__(self, scene: SceneConfig) -> None:
        self.scene = scene
        self._engine = Engine(scene, (*view.PLACING, *view.FRAME_EFFECTS))

    def frame(self, slot: int, attempt: int = 0, repeat: int = 0) -> RenderedFrame:
        """Return one image.

        Args:
            slot: Which sample of the scene.
            attempt: Which try at it.
            repeat: How often it was seen before: objects stay, the camera's noise is another.

        Raises:
            SimulationError: If clutter finds no place.
        """
        state = self._engine.run(SampleKey(self.scene.seed, slot, attempt, repeat))
        colours = _GREY[np.minimum(state.labels, FIRST_OBJECT)]
        item = self.scene.objects[object_index(self.scene, slot)]
        if item.colour is not None:
            colours[state.labels == FIRST_OBJECT] = item.colour
        shade = np.where(state.labels > TABLE, view.light(view.normals_of(state)), 1.0)
        return self._image(state.depth, (colours * shade[..., None]).astype(np.uint8), state.labels)

    def nothing(self) -> RenderedFrame:
        """Return an image without depth, and black."""
        shape = self._engine.world.rays.shape
        return self._image(np.zeros(shape[:2]), np.zeros(shape, np.uint8), np.zeros(shape[:2], np.int32))

    def _image(self, depth: Float64, rgb: UInt8, labels: Int32) -> RenderedFrame:
        world = self._engine.world
        return RenderedFrame(to_millimetres(depth), rgb, labels, world.view.matrix, world.plane.coefficients)


class SceneImages:
    """The image that a camera takes now, and when it was taken: before it was rendered.

    A sample is rendered when it is first seen, and up to four times where the camera's noise differs from image to
    image; these are then shown in turn. One that the scene has no place for is not shown: the camera measures nothing.

    Args:
        scene: The scene.
        schedule: Which sample is on the table when.
        clock_ns: Time of day [ns], by which the sample is chosen, so that a stamp identifies it.
    """

    def __init__(
        self, scene: SceneConfig, schedule: ScheduleConfig, clock_ns: Callable[[], int] = time.time_ns
    ) -> None:
        self._maker = FrameMaker(scene)
        self._schedule = schedule
        self._clock_ns = clock_ns
        noisy = (scene.camera.noise, scene.camera.flying_pixels, scene.camera.holes)
        self._views = _VIEWS if any(effect is not None for effect in noisy) else 1
        self._slot: int | None = None
        self._images: list[RenderedFrame] = []
        self.fault = ""  # why the last sample is not shown

    def __call__(self, number: int) -> tuple[RenderedFrame, int]:
        """Return the image with this number, and its stamp [ns]."""
        # Whole milliseconds come back from the library's double-precision stamps as they went in.
        taken_ns = self._clock_ns() // _MS_NS * _MS_NS
        slot = self._schedule.slot(taken_ns)
        if slot != self._slot:
            self._images, self._slot = [], slot
        if len(self._images) < self._views:
            self._images.append(self._render(slot, len(self._images)))
            return self._images[-1], taken_ns
        return self._images[number % self._views], taken_ns

    def _render(self, slot: int, repeat: int) -> RenderedFrame:
        self.fault = ""
        try:
            return self._maker.frame(slot, repeat=repeat)
        except SimulationError as err:
            self.fault = f"scene: sample {slot} is not shown: {err}"
            _LOG.warning(self.fault)
            return self._maker.nothing()
