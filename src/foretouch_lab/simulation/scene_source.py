# SPDX-License-Identifier: Apache-2.0
"""A scene as a source of the graph: which nodes show it, and the camera that sees it."""

from typing import Any, Final

from foretouch.camera.config import ScheduleConfig
from foretouch.models.registry import SIMULATED_HAND_MODEL
from foretouch_lab.simulation.scene import centre_of_objects, scheduled_scene
from foretouch_lab.simulation.scene_camera import SceneImages
from foretouch_lab.simulation.software_camera import SyntheticCamera

_FPS: Final = 5  # few, so that a small computer has time for the rest of the graph
_PATIENCE: Final = {"camera.silence_s": 20.0}  # a busy computer renders slowly


class SceneSource:
    """An `ImageSource`: a camera and a hand, which are given the same scene."""

    def nodes(self, show: ScheduleConfig, rate_hz: float | None) -> dict[str, dict[str, Any]]:
        """Return parameters of the camera and the hand, and of the nodes that must know what the scene holds."""
        scene = scheduled_scene(show)  # so that an error in it is reported before anything starts
        shown = {f"scene.{name}": value for name, value in show.to_mapping().items()}
        fps = _FPS if rate_hz is None else max(1, round(rate_hz))
        sensor = scene.fingers.sensor
        nodes: dict[str, dict[str, Any]] = {
            "perception": {"model": SIMULATED_HAND_MODEL},
            "hand": shown,
            "camera": {"source": "scene", "camera.fps": fps, **_PATIENCE, **shown},
        }
        if sensor:
            nodes["perception"]["tactile.sensor"] = sensor
            nodes["bridge"] = {"tactile.sensor": sensor}
        if scene.hand:  # whose thumb is at g1 in simulation
            nodes["perception"] |= {"hand.name": scene.hand, "hand.thumb_at": "g1"}
        if scene.clutter is not None:  # clutter has no tactile model, so only the object is grasped
            nodes["perception"] |= {
                "target.mode": "point",
                "target.point": centre_of_objects(scene).tolist(),
                "target.tolerance_m": 0.1,  # between the middle of the object and its visible part
            }
        return nodes

    def device(self, show: ScheduleConfig, fps: int, *, color: bool) -> SyntheticCamera:
        """Return the camera of a scene, perhaps with colours, not yet started; a `ConfigError` if it breaks a rule."""
        return SyntheticCamera(SceneImages(scheduled_scene(show), show), fps, serial="scene", color=color)


SCENE: Final = SceneSource()
