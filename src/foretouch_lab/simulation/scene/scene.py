# SPDX-License-Identifier: Apache-2.0
"""A scene read from YAML. A group that is absent switches its effect off."""

import itertools
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np

from foretouch.config import Settings, load_yaml, setting
from foretouch.errors import ConfigError
from foretouch_lab.simulation.contact.grip import LEVELS
from foretouch_lab.simulation.depth_scene import TABLE_M
from foretouch_lab.simulation.scene.camera import CameraConfig
from foretouch_lab.simulation.scene.campaign import CampaignConfig
from foretouch_lab.simulation.scene.fingers import FingersConfig, GraspsConfig
from foretouch_lab.simulation.scene.objects import ClutterConfig, ObjectConfig, draw_families
from foretouch_lab.simulation.scene.ranges import Switch
from foretouch_lab.simulation.scene.scene_hash import scene_hash


@dataclass(frozen=True, kw_only=True)
class SceneConfig(Settings):
    """Everything that decides the samples of a scene.

    Attributes:
        gravity: The object is lifted, so the fingers bear its weight.

    Raises:
        ConfigError: At a contradiction between fields; the message names them.
    """

    objects: tuple[ObjectConfig, ...] = (ObjectConfig(),)
    clutter: ClutterConfig | None = None
    camera: CameraConfig = CameraConfig()
    grasps: GraspsConfig = GraspsConfig()
    fingers: FingersConfig = FingersConfig()
    gravity: Switch | None = None
    campaign: CampaignConfig | None = None
    fidelity: str = setting(
        "auto", "Contact solver; auto: springs on rigid objects, elastic layers on soft ones", choices=("auto", *LEVELS)
    )
    max_attempts: int = setting(20, "Number of tries for one sample before it is given up", bounds=(1, 1000))
    seed: int = setting(0, "Seed of all that is drawn", bounds=(0, 2**53))

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.objects:
            raise ConfigError("objects: there is none")
        names = [item.name for item in self.objects]
        if len(set(names)) < len(names):
            raise ConfigError(f"objects: two have the name {max(names, key=names.count)}")
        for k, item in enumerate(self.objects):
            _require_in_view(self, item, f"objects[{k}] {item.name}")
            _require_in_reach(self, item, f"objects[{k}] {item.name}")
            if self.gravity is not None and item.mass_kg is None:
                raise ConfigError(f"objects[{k}] {item.name}.mass_kg: absent, but the scene has gravity")
        for name, instead in (("drift", "campaign.warm_up"), ("sessions", "campaign.drift")):
            if self.campaign is not None and getattr(self.fingers, name) is not None:
                raise ConfigError(
                    f"fingers.{name}: draws the time of each grasp or object, but the scene has a campaign; "
                    f"give {instead} in its place"
                )
        if self.campaign is not None and self.fingers.taxels is not None:
            raise ConfigError("campaign: its drift is that of the BioTac SP, but fingers.sensor is another")

    @classmethod
    def from_mapping(cls, mapping: Mapping[str, Any], source: str = "") -> Self:
        """As of all settings; besides, `families` are drawn here and stand after the objects that are listed.

        The path of a mesh, or of a sensor, is relative to the file of the scene, if it is there, else to the working folder.
        """
        given = dict(mapping)
        if isinstance(given.get("objects"), list):
            given["objects"] = [_beside(source, item, "file") for item in given["objects"]]
        if "fingers" in given:
            given["fingers"] = _beside(source, given["fingers"], "sensor")
        if "families" in given:
            drawn = draw_families(given.pop("families"), source)
            given["objects"] = [*given.get("objects", []), *(item.to_mapping() for item in drawn)]
        return super().from_mapping(given, source)

    def sha256(self) -> str:
        """Hash of all settings and of the constants that go with them, so that another default is another scene.

        Of the file of a mesh, or of a sensor, only the content counts.
        """
        return scene_hash(self.to_mapping(), self.fingers.taxel_sensor())


def load_scene(path: str | Path) -> SceneConfig:
    """Read a scene file; a `ConfigError` names file, field and rule."""
    return SceneConfig.from_mapping(load_yaml(path), str(path))


def _beside(source: str, group: Any, key: str) -> Any:
    """The settings of a group with the path of a file, where that is beside the file of the scene."""
    if not isinstance(group, Mapping) or not isinstance(group.get(key), str) or not group[key]:
        return group
    path = Path(source).parent / group[key]
    return {**group, key: str(path)} if source and path.is_file() else group


def _require_in_view(scene: SceneConfig, item: ObjectConfig, name: str) -> None:
    """The ball around the object must be in the image and over the table wherever the object may lie."""
    radius = float(np.linalg.norm(item.size_m)) / 2.0 * (1.0 + item.size_spread)
    reach = (-radius, radius)
    ends = itertools.product(item.pose.x_m, item.pose.y_m, reach, reach, (0.0, 2.0 * radius))
    points = np.array([[x + dx, y + dy, z] for x, y, dx, dy, z in ends])
    view = scene.camera.view()
    low, high = view.bounds(points)
    if (low < 0.0).any() or (high > np.array([view.width - 1, view.height - 1])).any():
        raise ConfigError(
            f"{name}.pose: may lie outside of the view, which is {view.width}x{view.height} pixels "
            f"of {scene.camera.hfov_deg:g} degrees at {scene.camera.distance_m:g} m"
        )
    if (np.abs([item.pose.x_m, item.pose.y_m]).max(axis=1) > TABLE_M / 2.0).any():
        raise ConfigError(f"{name}.pose: may lie beside the table of {TABLE_M.tolist()} m")


def _require_in_reach(scene: SceneConfig, item: ObjectConfig, name: str) -> None:
    narrowest = min(item.size_m) * (1.0 - item.size_spread)
    if narrowest > scene.grasps.max_width_m:
        raise ConfigError(
            f"{name}.size_m: {narrowest:g} m at its narrowest, the hand opens {scene.grasps.max_width_m:g} m "
            "(grasps.max_width_m)"
        )
