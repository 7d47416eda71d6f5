# SPDX-License-Identifier: Apache-2.0
"""A scene as a camera: images of its samples, fed to librealsense's software device.

From there on all is the code that a real camera runs.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable

from foretouch.camera import SyntheticCamera
from foretouch.errors import SimulationError
from foretouch.simulation.depth_scene import DepthImage
from foretouch.simulation.frames import FrameMaker
from foretouch.simulation.message_faults import FaultConfig, MessageFaults
from foretouch.simulation.scene import SceneConfig
from foretouch.simulation.show import ShowConfig

__all__ = ["SceneImages", "scene_camera"]

_LOG = logging.getLogger(__name__)
_MS_NS = 1_000_000
_VIEWS = 4  # of one sample, each with noise of its own; rendering takes most of a core


class SceneImages:
    """The image that a camera takes now: call it, then ask `stamp_ns` when it was taken.

    A sample is rendered when it is first seen, and up to four times where the camera's noise differs from image to
    image; these are then shown in turn. One that the scene has no place for is not shown: the camera measures nothing.

    Attributes:
        faults: With its counts.

    Args:
        scene: The scene.
        show: Which sample is on the table when.
        faults: Of the camera's clock, and images that get lost. A sample is on the table when the camera's clock
            says so, whatever the fault, so that a stamp still tells which it is.
        clock_ns: Time of day [ns].
    """

    def __init__(
        self,
        scene: SceneConfig,
        show: ShowConfig,
        faults: FaultConfig | None = None,
        clock_ns: Callable[[], int] = time.time_ns,
    ) -> None:
        self._maker = FrameMaker(scene)
        self._show = show
        self._clock_ns = clock_ns
        noisy = (scene.camera.noise, scene.camera.flying_pixels, scene.camera.holes)
        self._views = _VIEWS if any(effect is not None for effect in noisy) else 1
        self._slot: int | None = None
        self._images: list[DepthImage] = []
        self._taken_ns: int | None = None
        self.faults = MessageFaults(faults or FaultConfig())

    def __call__(self, number: int) -> DepthImage:
        """The image with this number."""
        now_ns = self._clock_ns()
        stamp_ns = self.faults.stamp(now_ns)
        # Whole milliseconds come back from the library's double-precision stamps as they went in.
        self._taken_ns = None if stamp_ns is None else stamp_ns // _MS_NS * _MS_NS
        slot = self._show.slot(now_ns if self._taken_ns is None else self._taken_ns)
        if slot != self._slot:
            self._images, self._slot = [], slot
        if len(self._images) < self._views:
            self._images.append(self._render(slot, len(self._images)))
            return self._images[-1]
        return self._images[number % self._views]

    def stamp_ns(self, number: int) -> int | None:  # noqa: ARG002
        """When the last image was taken: before it was rendered [ns]; None if it is to be lost."""
        return self._taken_ns

    def _render(self, slot: int, repeat: int) -> DepthImage:
        try:
            return self._maker.frame(slot, repeat=repeat)
        except SimulationError as err:
            if err.reason == "effect":
                raise  # a mistake in the program, not in the sample
            _LOG.warning("scene: sample %d is not shown: %s", slot, err)
            return self._maker.nothing()


def scene_camera(scene: SceneConfig, show: ShowConfig, fps: int, faults: FaultConfig | None = None) -> SyntheticCamera:
    """A device that streams a scene, not yet started.

    Args:
        scene: The scene; its camera decides size and lens.
        show: Which sample is on the table when.
        fps: Images a second, as far as rendering keeps up [Hz].
        faults: Of stamps and images.
    """
    images = SceneImages(scene, show, faults)
    return SyntheticCamera(images, fps, serial="scene", stamp_ns=images.stamp_ns)
