# SPDX-License-Identifier: Apache-2.0
"""Scenes: typed settings read from YAML; contradictions are refused with a reason."""

from foretouch.simulation.scene.camera import CameraConfig
from foretouch.simulation.scene.campaign import CampaignConfig, DriftTermConfig, ExchangeConfig
from foretouch.simulation.scene.fingers import FingersConfig, GraspsConfig
from foretouch.simulation.scene.objects import (
    ClutterConfig,
    FamilyConfig,
    ObjectConfig,
    PoseConfig,
    SurfaceConfig,
    TableConfig,
    draw_objects,
)
from foretouch.simulation.scene.scene import GravityConfig, SceneConfig, load_scene

__all__ = [
    "CameraConfig",
    "CampaignConfig",
    "ClutterConfig",
    "DriftTermConfig",
    "ExchangeConfig",
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
