# SPDX-License-Identifier: Apache-2.0
"""Plan two-finger grasps from a depth camera, and predict what tactile fingertips will read, before anything moves.

    import foretouch as ft
    scene = ft.segment(ft.Cloud.from_depth(depth, K))
    grasps = ft.plan(scene.objects[0])
    touch = ft.load_model().predict(scene.objects[0], grasps)
    ft.draw(scene, grasps, touch)

Names are loaded when they are first used. Lengths are in metres, in the optical frame of the camera (x right, y down,
z forward); readings are in the unit of their sensor.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from foretouch.api import calibrate, draw, evaluate, fit, open, plan, reading, segment  # noqa: A004
    from foretouch.cloud.io.files import read_cloud, write_cloud
    from foretouch.dataset.writing import write
    from foretouch.errors import ForetouchError
    from foretouch.models.predictor import Estimate
    from foretouch.models.registry import available_models, load_model
    from foretouch.models.touch_model import History, TouchModel
    from foretouch.pipeline import Pipeline, PipelineConfig
    from foretouch.types import (
        CameraModel,
        Cloud,
        Grasp,
        Grasps,
        Plane,
        Predicted,
        Prediction,
        Predictions,
        Sample,
        Touch,
    )
    from foretouch.types.scene import Object, Scene

__version__ = "0.4.0"

_PLACES = {
    "foretouch.api": ("calibrate", "draw", "evaluate", "fit", "open", "plan", "reading", "segment"),
    "foretouch.cloud.io.files": ("read_cloud", "write_cloud"),
    "foretouch.dataset.writing": ("write",),
    "foretouch.errors": ("ForetouchError",),
    "foretouch.models.predictor": ("Estimate",),
    "foretouch.models.registry": ("available_models", "load_model"),
    "foretouch.models.touch_model": ("History", "TouchModel"),
    "foretouch.pipeline": ("Pipeline", "PipelineConfig"),
    "foretouch.types": (
        *("CameraModel", "Cloud", "Grasp", "Sample", "Grasps", "Plane"),
        *("Predicted", "Prediction", "Predictions", "Touch"),
    ),
    "foretouch.types.scene": ("Object", "Scene"),
}
_MODULES = {name: module for module, names in _PLACES.items() for name in names}

__all__ = [
    "CameraModel",
    "Cloud",
    "Estimate",
    "ForetouchError",
    "Grasp",
    "Grasps",
    "History",
    "Object",
    "Pipeline",
    "PipelineConfig",
    "Plane",
    "Predicted",
    "Prediction",
    "Predictions",
    "Sample",
    "Scene",
    "Touch",
    "TouchModel",
    "__version__",
    "available_models",
    "calibrate",
    "draw",
    "evaluate",
    "fit",
    "load_model",
    "open",
    "plan",
    "read_cloud",
    "reading",
    "segment",
    "write",
    "write_cloud",
]


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module 'foretouch' has no attribute {name!r}")
    value = getattr(import_module(_MODULES[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted([*__all__, *globals()])
