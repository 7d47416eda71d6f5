# SPDX-License-Identifier: Apache-2.0
"""What the camera of a scene gives: whole images, for camera nodes, recordings and software devices."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from foretouch.simulation.depth_scene import FIRST_OBJECT, TABLE, DepthImage
from foretouch.simulation.engine import Engine
from foretouch.simulation.scene import SceneConfig
from foretouch.simulation.steps import place, view
from foretouch.simulation.streams import SampleKey
from foretouch.simulation.world import World

__all__ = ["FrameMaker"]

_GREY = np.array([[60, 60, 66], [150, 140, 125], [196, 140, 90]], np.float64)  # floor, table, and what has no colour


class FrameMaker:
    """Makes images of a scene; slot k shows what sample k was taken from, with camera noise of its own.

    Args:
        scene: The scene. Effects of hand and fingers do not run.
    """

    def __init__(self, scene: SceneConfig) -> None:
        self.scene = scene
        self._world = World.of(scene)
        seeing = [replace(effect, again=True) for effect in view.FRAME_EFFECTS]
        self._engine = Engine(scene, (*place.EFFECTS, *seeing), ("depth", "labels", "normals"))

    def frame(self, slot: int, attempt: int = 0, repeat: int = 0) -> DepthImage:
        """One image.

        Args:
            slot: Which sample of the scene.
            attempt: Which try at it.
            repeat: How often it was seen before: objects stay, the camera's noise is another.

        Raises:
            SimulationError: If clutter finds no place.
        """
        state = self._engine.run(SampleKey(self.scene.seed, slot, attempt, repeat))
        millimetres = np.where(np.isfinite(state.depth), np.rint(state.depth * 1000.0), 0.0)
        depth_mm = np.where((millimetres > 0.0) & (millimetres < 65536.0), millimetres, 0.0).astype(np.uint16)
        colours = _GREY[np.minimum(state.labels, FIRST_OBJECT)]
        item = self.scene.objects[slot % len(self.scene.objects)]
        if item.colour is not None:
            colours[state.labels == FIRST_OBJECT] = item.colour
        shade = np.where(state.labels > TABLE, 0.35 + 0.65 * np.abs(state.normals[..., 2]), 1.0)
        rgb = (colours * shade[..., None]).astype(np.uint8)
        view_ = self._world.view
        return DepthImage(depth_mm, rgb, state.labels, view_.matrix, self._world.plane.coefficients)

    def nothing(self) -> DepthImage:
        """An image without depth, and black."""
        view_ = self._world.view
        depth = np.zeros((view_.height, view_.width), np.uint16)
        rgb, labels = np.zeros((*depth.shape, 3), np.uint8), np.zeros(depth.shape, np.int32)
        return DepthImage(depth, rgb, labels, view_.matrix, self._world.plane.coefficients)
