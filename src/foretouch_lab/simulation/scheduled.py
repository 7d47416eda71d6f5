# SPDX-License-Identifier: Apache-2.0
"""The scene of a schedule, and where its objects lie: what a simulated camera and hand begin with."""

import numpy as np

from foretouch.camera.schedule import ScheduleConfig
from foretouch.errors import ConfigError
from foretouch.types import Float64
from foretouch_lab.simulation.scene import SceneConfig, load_scene


def scheduled_scene(schedule: ScheduleConfig) -> SceneConfig:
    """The scene; a `ConfigError` if there is no path, or the file breaks a rule."""
    if not schedule.path:
        raise ConfigError("path: is empty; name a scene file")
    return load_scene(schedule.path)


def centre_of_objects(scene: SceneConfig) -> Float64:
    """(3,) float64 [m], camera frame: where the object is to be looked for among clutter.

    The mean of the places where objects may lie, at half their mean height.
    """
    places = [(np.mean(item.pose.x_m), np.mean(item.pose.y_m), np.mean(item.size_m) / 2.0) for item in scene.objects]
    return scene.camera.view().to_camera(np.mean(places, axis=0))
