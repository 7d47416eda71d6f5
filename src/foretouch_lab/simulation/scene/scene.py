# SPDX-License-Identifier: Apache-2.0
"""A scene read from YAML: objects, camera, fingers, grasps. A group that is absent switches its effect off.

Its hash covers all settings, defaults included, and constants that decide samples as settings do. The hash of
`config/scenes/deformables.yaml` is frozen (`deformables.sha256`): results name the scene by it.
"""

import hashlib
import itertools
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Self

import numpy as np

from foretouch.camera.config import ScheduleConfig
from foretouch.config import Settings, load_description, setting
from foretouch.errors import ConfigError
from foretouch.grasp.hand import load_hand
from foretouch.tactile import FULL_SCALE
from foretouch.tactile.channels import CORE_HALF_LENGTH_M, CORE_RADIUS_M
from foretouch.types import Float64
from foretouch_lab.simulation import fingertip, taxels
from foretouch_lab.simulation.contact import layer, pad, problem
from foretouch_lab.simulation.contact.grip import LEVELS
from foretouch_lab.simulation.depth_scene import (
    D415_BASELINE_M,
    FLYING_SHARE,
    GRAZING_DEG,
    HOLE_SHARE,
    TABLE_M,
    CameraView,
)
from foretouch_lab.simulation.scene.campaign import (
    CONTACT_S,
    FINGER_KELVIN,
    OBJECT_KELVIN,
    SESSION_KELVIN,
    SLOPE_MF,
    SLOPE_SPREAD,
    SLOPE_TH,
    CampaignConfig,
)
from foretouch_lab.simulation.scene.fingers import TARGET_SHARE, FingersConfig, GraspsConfig
from foretouch_lab.simulation.scene.objects import POISSON, RELIEF_M, ClutterConfig, ObjectConfig, draw_families
from foretouch_lab.simulation.scene.ranges import Switch


@dataclass(frozen=True, kw_only=True)
class DepthNoiseConfig(Settings):
    """Error of the stereo matching, sigma_z = s z² / (f B), correlated over the matching window."""

    sub_pixel: float = setting(0.05, "Standard deviation s of the disparity", unit="px", bounds=(0.0, 1.0))


@dataclass(frozen=True, kw_only=True)
class CameraConfig(Settings):
    """An eye-to-hand camera that looks at the world's origin.

    The defaults give a point every 2 mm, as the clouds of the first paper have: a D415 at 640x480, aligned to
    colour, has a focal length of about 615 px, hence 55 degrees across.

    Attributes:
        noise: Noise of the depth.
        stereo: What only one of the two imagers, side by side, sees has no depth.
        flying_pixels: Half of the pixels at a depth edge lie between both sides.
        holes: Pixels have no depth at random spots, and where the surface turns away from the camera.
        segmented: The object's points are what segmentation finds in the image, as in the graph: steep flanks lack some.
    """

    width: int = setting(640, "Columns of the image", unit="px", bounds=(16, 1920))
    height: int = setting(480, "Rows of the image", unit="px", bounds=(16, 1080))
    hfov_deg: float = setting(55.0, "Horizontal field of view", bounds=(10.0, 120.0))
    distance_m: float = setting(1.25, "Distance from the world's origin", bounds=(0.16, 10.0))
    tilt_deg: float = setting(
        0.0, "Angle between the optical axis and the vertical; 0 looks straight down", bounds=(0.0, 85.0)
    )
    z_step_m: float | None = setting(None, "Step that depth is rounded to; absent for exact depth", bounds=(1e-5, 0.05))
    noise: DepthNoiseConfig | None = None
    stereo: Switch | None = None
    flying_pixels: Switch | None = None
    holes: Switch | None = None
    segmented: Switch | None = None

    def view(self) -> CameraView:
        """Return pose and intrinsics in the world."""
        return CameraView.towards_table(
            self.width, self.height, self.distance_m, float(np.radians(self.tilt_deg)), self.hfov_deg
        )


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
    hand: str = setting(
        "", "Hand whose posture turns the fingertips: name or YAML file of a description; empty: they face each other"
    )
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
            if self.gravity is not None and item.mass_kg is None:
                raise ConfigError(f"objects[{k}] {item.name}.mass_kg: absent, but the scene has gravity")
        if self.hand:
            try:
                load_hand(self.hand)
            except ConfigError as err:
                raise ConfigError(f"hand: {err}") from err
        for name, instead in (("drift", "campaign.warm_up"), ("sessions", "campaign.drift")):
            if self.campaign is not None and getattr(self.fingers, name) is not None:
                raise ConfigError(
                    f"fingers.{name}: draws the time of each grasp or object, but the scene has a campaign; "
                    f"give {instead} in its place"
                )
        if self.campaign is not None and self.fingers.taxels is not None:
            raise ConfigError("campaign: its drift is for the BioTac SP, but fingers.sensor is another")

    @classmethod
    def from_mapping(cls, mapping: Mapping[str, Any], source: str = "") -> Self:
        """Make the settings from plain data; `families` are drawn here and stand after the objects that are listed.

        The path of a mesh, of a hand or of a sensor is relative to the file of the scene, if it is there, else to the working folder.
        """
        given = dict(mapping)
        if isinstance(given.get("objects"), list):
            given["objects"] = [_beside(source, item, "file") for item in given["objects"]]
        given = _beside(source, given, "hand")
        if "fingers" in given:
            given["fingers"] = _beside(source, given["fingers"], "sensor")
        if "families" in given:
            drawn = draw_families(given.pop("families"), source)
            given["objects"] = [*given.get("objects", []), *(item.to_mapping() for item in drawn)]
        return super().from_mapping(given, source)

    def sha256(self) -> str:
        """Return the hash of all settings and of the constants that go with them, so that another default is another scene.

        Of the file of a mesh, a hand or a sensor, only the content counts.
        """
        settings = self.to_mapping()
        settings["hand"] = load_hand(self.hand).config.to_mapping() if self.hand else 0
        counted = _counted(settings, _CONSTANTS)
        if (sensor := self.fingers.taxel_sensor()) is not None:
            noise = [channel.noise for channel in (*sensor.config.values, *sensor.config.scalars)]
            counted["taxels"] = {**_TAXELS, "sensor": sensor.sha256, "noise": noise, "valid": sensor.valid.tolist()}
        text = json.dumps(counted, sort_keys=True, separators=(",", ":"))
        return hashlib.sha256(text.encode()).hexdigest()


def load_scene(path: str | Path) -> SceneConfig:
    """Read a scene file; a `ConfigError` names file, field and rule."""
    return load_description(path, SceneConfig, "a scene", ["families"])


def scheduled_scene(schedule: ScheduleConfig) -> SceneConfig:
    """Return the scene of a schedule; a `ConfigError` if there is no path, or the file breaks a rule."""
    if not schedule.path:
        raise ConfigError("path: is empty; name a scene file")
    return load_scene(schedule.path)


def centre_of_objects(scene: SceneConfig) -> Float64:
    """Return (3,) float64 [m], camera frame: where the object is to be looked for among clutter.

    The mean of the places where objects may lie, at half their mean height.
    """
    places = [(np.mean(item.pose.x_m), np.mean(item.pose.y_m), np.mean(item.size_m) / 2.0) for item in scene.objects]
    return scene.camera.view().to_camera(np.mean(places, axis=0))


def _beside(source: str, group: Any, key: str) -> Any:
    """Return the settings of a group with the path of a file, where that is beside the file of the scene."""
    if not isinstance(group, Mapping) or not isinstance(group.get(key), str) or not group[key]:
        return group
    path = Path(source).parent / group[key]
    return {**group, key: str(path)} if source and path.is_file() else group


def _require_in_view(scene: SceneConfig, item: ObjectConfig, name: str) -> None:
    """Require the ball around the object to be in the image wherever the object may lie."""
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


def _grouped(flat: Mapping[str, Any]) -> dict[str, Any]:
    """Return groups by dotted names."""
    groups: dict[str, Any] = {}
    for name, value in flat.items():
        *path, last = name.split(".")
        group = groups
        for key in path:
            group = group.setdefault(key, {})
        group[last] = value
    return groups


_CONSTANTS: Final = _grouped({
    "objects.poisson": POISSON,
    "objects.surface.relief_m": RELIEF_M,
    "table.size_m": TABLE_M.tolist(),
    "camera.noise.baseline_m": D415_BASELINE_M,
    "camera.stereo.baseline_m": D415_BASELINE_M,
    "camera.flying_pixels.share": FLYING_SHARE,
    "camera.holes.share": HOLE_SHARE,
    "camera.holes.grazing_deg": GRAZING_DEG,
    "grasps.balanced": True,
    "grasps.middle": None,
    "grasps.error.target_share": TARGET_SHARE,
    "fingers.pad.core_half_length_m": CORE_HALF_LENGTH_M,
    "fingers.pad.core_radius_m": CORE_RADIUS_M,
    "fingers.pad.poisson": pad.POISSON,
    "fingers.pad.friction": 0.783,
    "fingers.pad.soft_window_m": pad.SOFT_WINDOW_M,
    "fingers.contact.tolerance": layer.TOLERANCE,
    "fingers.contact.max_iterations": layer.MAX_ITERATIONS,
    "fingers.contact.max_strain": problem.MAX_STRAIN,
    "fingers.fingertip.electrodes.kernel_m": fingertip.KERNEL_M,
    "fingers.fingertip.electrodes.thinning_m": fingertip.THINNING_M,
    "fingers.fingertip.electrodes.bulge_area_m2": fingertip.BULGE_AREA_M2,
    "fingers.fingertip.fluid.bottoming_m": fingertip.BOTTOMING_M,
    "fingers.fingertip.fluid.saturation_m3": fingertip.SATURATION_M3,
    "fingers.fingertip.fluid.span_counts": fingertip.PDC_SPAN,
    "fingers.fingertip.fluid.rim_power": fingertip.RIM_POWER,
    "fingers.fingertip.pdc_lowest": 0,
    "fingers.fingertip.pdc_highest": FULL_SCALE,
    **{
        f"fingers.{finger}.{name}": value
        for finger in ("thumb", "middle")
        for name, value in (
            ("pdc_gain", 1.0),
            ("electrode_rest_spread", fingertip.REST_SPREAD),
            ("electrode_gain", 1.0),
            ("electrode_gain_spread", fingertip.GAIN_SPREAD),
        )
    },
    "fingers.noise.electrode_counts": fingertip.NOISE_ELECTRODE,
    "fingers.noise.pdc_counts": fingertip.NOISE_PDC,
    "fingers.noise.wander_counts": fingertip.WANDER_COUNTS,
    "fingers.noise.wander_s": fingertip.WANDER_S,
    "fingers.dead.stuck_at": "low",
    "fingers.crosstalk": taxels.CROSSTALK,
    "fingers.taxels.full_scale_n": taxels.FULL_SCALE_N,
    "fingers.drift.session_s": fingertip.SESSION_S,
    "fingers.drift.tare_age_s": fingertip.TARE_AGE_S,
    "fingers.drift.temperature.body_kelvin": fingertip.BODY_KELVIN,
    "fingers.drift.temperature.warming_s": fingertip.WARMING_S,
    "fingers.drift.temperature.electrode_counts_per_kelvin": fingertip.ELECTRODE_PER_KELVIN,
    "fingers.drift.temperature.pdc_counts_per_kelvin": fingertip.PDC_PER_KELVIN,
    "campaign.warm_up.tdc.session_kelvin": SESSION_KELVIN,
    "campaign.warm_up.tdc.finger_kelvin": FINGER_KELVIN,
    "campaign.warm_up.tdc.object_kelvin": OBJECT_KELVIN,
    "campaign.warm_up.tdc.contact_s": CONTACT_S,
    "campaign.warm_up.tdc.slope_th": SLOPE_TH,
    "campaign.warm_up.tdc.slope_mf": SLOPE_MF,
    "campaign.warm_up.tdc.slope_spread": SLOPE_SPREAD,
})  # fmt: skip
_TAXELS: Final = {
    name.lower(): getattr(taxels, name) for name in ("REST_SPREAD", "NOISE_N", "SESSION_N", "KELVIN_N")
} | {"gain_spread": fingertip.GAIN_SPREAD, "steepest": problem.STEEPEST}
# Settings that do not count at these values.
_OFF: Final = {
    **dict.fromkeys(("campaign", "sessions", "tdc", "repeat_every", "segmented", "taxels", "crosstalk")),
    "pdc_span": fingertip.PDC_SPAN,
    "method": "original",
    "flying_share": 1.0,
    "first_variant": 0,
    "hand": 0,
    "file_sha256": "",
}


def _counted(settings: dict[str, Any], constants: dict[str, Any]) -> dict[str, Any]:
    """Return the settings that count, with the constants of those groups that are given."""
    counted: dict[str, Any] = {}
    for key, value in (constants | settings).items():
        if isinstance(value, dict):
            counted[key] = _counted(settings.get(key, {}), constants.get(key, {}))
        elif isinstance(value, list):
            counted[key] = [
                _counted(item, constants.get(key, {})) if isinstance(item, dict) else item for item in value
            ]
        elif key not in ("file", "sensor") and (key not in _OFF or value != _OFF[key]):
            counted[key] = value
    return counted
