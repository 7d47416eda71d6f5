# SPDX-License-Identifier: Apache-2.0
"""The hash of a scene: of all settings, defaults included, and of constants that decide samples as settings do.

The hash of `config/scenes/deformables.yaml` is frozen (`deformables.sha256`): results name the scene by it.
"""

import hashlib
import json
from typing import Any, Final

from foretouch.tactile import FULL_SCALE, skin
from foretouch.tactile.description import Sensor
from foretouch_lab.simulation import disturbances, fingertip, taxels
from foretouch_lab.simulation.contact import layer, pad, problem, shear
from foretouch_lab.simulation.depth_effects import D415_BASELINE_M, FLYING_SHARE, GRAZING_DEG, HOLE_SHARE
from foretouch_lab.simulation.depth_scene import TABLE_M
from foretouch_lab.simulation.scene.fingers import TARGET_SHARE
from foretouch_lab.simulation.scene.objects import POISSON

_FINGER: Final = {
    "pdc_gain": 1.0,
    "electrode_rest_spread": fingertip.REST_SPREAD,
    "electrode_gain": 1.0,
    "electrode_gain_spread": fingertip.GAIN_SPREAD,
}
_CONSTANTS: Final[dict[str, Any]] = {
    "objects": {"poisson": POISSON},
    "table": {"size_m": TABLE_M.tolist()},
    "camera": {
        "noise": {"baseline_m": D415_BASELINE_M},
        "stereo": {"baseline_m": D415_BASELINE_M},
        "flying_pixels": {"share": FLYING_SHARE},
        "holes": {"share": HOLE_SHARE, "grazing_deg": GRAZING_DEG},
    },
    "grasps": {"error": {"target_share": TARGET_SHARE}},
    "fingers": {
        "pad": {
            "core_half_length_m": skin.CORE_HALF_LENGTH_M,
            "core_radius_m": skin.CORE_RADIUS_M,
            "poisson": pad.POISSON,
            "friction": 0.783,
            "soft_window_m": pad.SOFT_WINDOW_M,
        },
        "contact": {
            "tolerance": layer.TOLERANCE,
            "max_iterations": layer.MAX_ITERATIONS,
            "max_strain": problem.MAX_STRAIN,
        },
        "fingertip": {
            "electrodes": {
                "kernel_m": fingertip.KERNEL_M,
                "thinning_m": fingertip.THINNING_M,
                "bulge_area_m2": fingertip.BULGE_AREA_M2,
            },
            "fluid": {
                "bottoming_m": fingertip.BOTTOMING_M,
                "saturation_m3": fingertip.SATURATION_M3,
                "span_counts": fingertip.PDC_SPAN,
                "rim_power": fingertip.RIM_POWER,
            },
            "pdc_lowest": 0,
            "pdc_highest": FULL_SCALE,
        },
        "thumb": _FINGER,
        "middle": _FINGER,
        "noise": {"wander_counts": disturbances.WANDER_COUNTS, "wander_s": disturbances.WANDER_S},
        "drift": {
            "temperature": {
                "electrode_counts_per_kelvin": disturbances.ELECTRODE_PER_KELVIN,
                "pdc_counts_per_kelvin": disturbances.PDC_PER_KELVIN,
            }
        },
    },
}
_TAXELS: Final = {
    name.lower(): getattr(taxels, name) for name in ("REST_SPREAD", "NOISE_N", "SESSION_N", "KELVIN_N")
} | {"gain_spread": fingertip.GAIN_SPREAD, "steepest": shear.STEEPEST}
# Settings that do not count at these values.
_OFF: Final = {
    **dict.fromkeys(
        ("campaign", "sessions", "tdc", "fluid_loss", "vibration", "repeat_every", "segmented", "taxels", "crosstalk")
    ),
    "pdc_span": fingertip.PDC_SPAN,
    "method": "original",
    "flying_share": 1.0,
    "first_variant": 0,
    "hand": 0,
    "file_sha256": "",
    "slow_share": 0.0,
    "slow_s": 30.0,
}


def scene_hash(settings: dict[str, Any], sensor: Sensor | None = None) -> str:
    """SHA-256 of a scene's plain settings, and of the array of taxels if it has one; paths of meshes and sensors do not count."""
    counted = _counted(settings, _CONSTANTS)
    if sensor is not None:
        noise = [one.noise for one in (*sensor.config.values, *sensor.config.scalars)]
        counted["taxels"] = {**_TAXELS, "sensor": sensor.sha256, "noise": noise, "valid": sensor.valid.tolist()}
    text = json.dumps(counted, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def _counted(settings: dict[str, Any], constants: dict[str, Any]) -> dict[str, Any]:
    """The settings that count, with the constants of those groups that are given."""
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
