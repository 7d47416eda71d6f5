# SPDX-License-Identifier: Apache-2.0
"""Small scenes and single states, shared by the tests of the simulator."""

from functools import lru_cache
from typing import Any

import numpy as np

from foretouch.types import Sample
from foretouch_lab.simulation.effects import EFFECTS
from foretouch_lab.simulation.engine import Engine, SampleState
from foretouch_lab.simulation.scene import SceneConfig
from foretouch_lab.simulation.simulate import Simulation
from foretouch_lab.simulation.world import SampleKey

CAN = {"name": "can", "shape": "can", "size_m": [0.07, 0.07, 0.1], "pose": {"rest": "side"}}
SPONGE = {"name": "sponge", "shape": "sponge", "size_m": [0.07, 0.11, 0.05], "young_pa": 2e5, "thickness_m": 0.02}
SHORT = {"course__rest_s": 0.2, "course__approach_s": 0.1, "course__close_s": 0.1, "course__hold_s": 0.2}
"""Parameters of the hand node, for grasps that take less than a second."""
EVERY_CAMERA_FAULT = {"z_step_m": 0.001, "noise": {}, "stereo": {}, "flying_pixels": {}, "holes": {}}
EVERY_FINGER_EFFECT = {name: {} for name in ("timeline", "creep", "slip", "drift", "noise", "scan")} | {
    "dead": {"thumb": [3]}
}


def scene(*objects: dict[str, Any], **groups: Any) -> SceneConfig:
    """A scene of these objects (a rigid can if there is none) with some of its groups."""
    return SceneConfig.from_mapping({"objects": list(objects) or [CAN], **groups})


def run(config: SceneConfig, until: str = "", *, slot: int = 0, repeat: int = 0) -> SampleState:
    """The first try at a sample; the effects after the one with the name `until` are left out."""
    return _engine(config, until).run(SampleKey(config.seed, slot, 0, repeat))


def made(config: SceneConfig, count: int) -> list[Sample]:
    """The first samples of a scene."""
    return list(Simulation(config).samples(count))


@lru_cache(maxsize=8)
def _engine(config: SceneConfig, until: str) -> Engine:
    last = next((k for k, effect in enumerate(EFFECTS) if effect.name == until), len(EFFECTS))
    return Engine(config, EFFECTS[: last + 1])


def unit(vector: Any) -> Any:
    """Of length 1."""
    return np.asarray(vector) / np.linalg.norm(vector)
