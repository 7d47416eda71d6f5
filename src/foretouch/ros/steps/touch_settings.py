# SPDX-License-Identifier: Apache-2.0
"""Settings of the step that predicts touch."""

from dataclasses import dataclass, field
from typing import Final

from foretouch.cloud.geometry.limits import ObjectLimits
from foretouch.config import setting
from foretouch.dataset.labelling.cut import PairingConfig
from foretouch.grasp import CarriedConfig, GeoGraspConfig, HandConfig
from foretouch.grasp.reach import ReachConfig
from foretouch.models.registry import MODEL_WORDS, PREDICTOR_WORDS
from foretouch.ros.messages.tactile import TactileInput
from foretouch.ros.steps.frames import FrameSettings
from foretouch_msgs.action import SampleGrasps

PRESSURE: Final = SampleGrasps.Goal.PRESSURE
SCORE: Final = SampleGrasps.Goal.SCORE
HARDER_FINGER: Final = "harder_finger"
COSTS: Final = (PRESSURE, SCORE, HARDER_FINGER)
"""Names of the rules for the cost of a grasp."""


@dataclass(frozen=True, kw_only=True)
class TouchSettings(ReachConfig, TactileInput, FrameSettings):
    """Settings of the step, with the hand's reach and its tactile messages."""

    model: str = setting("default", MODEL_WORDS, read_only=True)
    predictor: str = setting("", PREDICTOR_WORDS, read_only=True)
    fallback_model: str = setting(
        "", "Model to use, with a flag, if `model` cannot be loaded; none if empty", read_only=True
    )
    late_after_s: float = setting(
        0.5, "Age of a cloud beyond which its predictions are flagged late; 0 for never", bounds=(0.0, 3600.0)
    )
    thumb_takes_g1: bool = setting(True, "Whether the markers show the thumb at g1, else the middle finger")
    use_tare: bool = setting(True, "Whether predictions use the tare: the tactile readings at rest")
    tare_max_age_s: float = setting(60.0, "Age beyond which the tare is not used", bounds=(0.0, 1e6))
    use_touches: bool = setting(
        True, "Whether predictions adapt to the tactile readings of executed grasps of the same object"
    )
    forget_after_s: float = setting(
        300.0, "Time after the last touch of an object until its touches are forgotten", bounds=(0.0, 1e6)
    )
    same_object_m: float = setting(
        0.02, "How far an object may have moved, or changed in apparent size, since it was touched", bounds=(0.0, 1.0)
    )
    hand_name: str = setting(
        "",
        "Name of the hand, such as right: what its sensors read is kept in a file of this name across restarts; empty: until "
        "the node ends",
        read_only=True,
    )
    history_folder: str = setting(
        "", "Folder of these files (default: foretouch in XDG_STATE_HOME, ~/.local/state)", read_only=True
    )
    max_grasps: int = setting(1000, "Maximum number of grasps in a request", bounds=(1, 10_000))
    sample_cost: str = setting(PRESSURE, "Cost of sampled grasps for goals that name none", choices=COSTS)
    pairing: PairingConfig = field(default_factory=PairingConfig)
    limits: ObjectLimits = ObjectLimits()
    grasp: GeoGraspConfig = GeoGraspConfig()
    hand: HandConfig = HandConfig()
    object: CarriedConfig = CarriedConfig()
