# SPDX-License-Identifier: Apache-2.0
"""Scenes: typed settings read from YAML; contradictions are refused with a reason."""

from foretouch.simulation.scene.camera import CameraConfig
from foretouch.simulation.scene.campaign import CampaignConfig, DriftTermConfig, ExchangeConfig
from foretouch.simulation.scene.fingers import (
    DeadConfig,
    DriftConfig,
    ExecutionErrorConfig,
    FingersConfig,
    GraspsConfig,
    TimelineConfig,
)
from foretouch.simulation.scene.objects import ClutterConfig, FamilyConfig, ObjectConfig, SurfaceConfig
from foretouch.simulation.scene.ranges import draw
from foretouch.simulation.scene.scene import SceneConfig, load_scene

__all__ = [
    "CameraConfig",
    "CampaignConfig",
    "ClutterConfig",
    "DeadConfig",
    "DriftConfig",
    "DriftTermConfig",
    "ExchangeConfig",
    "ExecutionErrorConfig",
    "FamilyConfig",
    "FingersConfig",
    "GraspsConfig",
    "ObjectConfig",
    "SceneConfig",
    "SurfaceConfig",
    "TimelineConfig",
    "draw",
    "load_scene",
]
