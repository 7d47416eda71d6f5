# SPDX-License-Identifier: Apache-2.0
"""Scenes: typed, read from YAML, contradictions named."""

from foretouch.simulation.scene.camera import CameraConfig
from foretouch.simulation.scene.families import FamilyConfig, draw_objects
from foretouch.simulation.scene.fingers import FingersConfig
from foretouch.simulation.scene.grasps import GraspsConfig
from foretouch.simulation.scene.scene import GravityConfig, SceneConfig, load_scene
from foretouch.simulation.scene.things import ClutterConfig, ObjectConfig, PoseConfig, SurfaceConfig, TableConfig

__all__ = [
    "CameraConfig",
    "ClutterConfig",
    "FamilyConfig",
    "FingersConfig",
    "GraspsConfig",
    "GravityConfig",
    "ObjectConfig",
    "PoseConfig",
    "SceneConfig",
    "SurfaceConfig",
    "TableConfig",
    "draw_objects",
    "load_scene",
]
