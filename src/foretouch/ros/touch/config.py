# SPDX-License-Identifier: Apache-2.0
"""Settings of the touch predictor."""

from __future__ import annotations

from dataclasses import dataclass, field

from foretouch.config import setting
from foretouch.dataset.pairing import PairingConfig
from foretouch.grasp import GeoGraspConfig
from foretouch.ros.messages.tactile import AdapterConfig
from foretouch.ros.runtime.processing_node import ProcessingConfig
from foretouch.tactile import TactileRanges
from foretouch.tactile.contact_detector import ContactConfig

__all__ = ["TouchPredictorConfig"]


@dataclass(frozen=True, kw_only=True)
class TouchPredictorConfig(ProcessingConfig):
    """Settings of the touch predictor; those of the hand have the names that the recorder gives them."""

    model: str = setting("default", "Name of a shipped model, or the path of a checkpoint", read_only=True)
    fallback_model: str = setting("", "Model used, and flagged, where `model` cannot be; none if empty", read_only=True)
    late_after_s: float = setting(
        0.5,
        "Age of a cloud beyond which its predictions are flagged late; 0 for never",
        unit="s",
        minimum=0.0,
        maximum=3600.0,
    )
    thumb_takes_g1: bool = setting(True, "Which finger the markers put at g1: thumb, else middle finger")
    use_tare: bool = setting(True, "Whether predictions lean on what the fingertips read at rest")
    tare_max_age_s: float = setting(
        60.0, "Time after which what was read at rest no longer counts", unit="s", minimum=0.0, maximum=1e6
    )
    use_touches: bool = setting(True, "Whether predictions lean on what was read in grasps of the same object")
    forget_after_s: float = setting(
        300.0, "Time after the last touch of an object at which its touches are forgotten", unit="s", minimum=0.0,
        maximum=1e6,
    )  # fmt: skip
    same_object_m: float = setting(
        0.02, "How far an object may have moved, or seem to have changed in size, since it was touched", unit="m",
        minimum=0.0, maximum=1.0,
    )  # fmt: skip
    tactile_topic: str = setting("/rh/tactile", "What the hand sends", read_only=True)
    tactile: AdapterConfig = field(default_factory=AdapterConfig)
    pairing: PairingConfig = field(default_factory=PairingConfig)
    contact: ContactConfig = field(default_factory=ContactConfig)
    grasp: GeoGraspConfig = GeoGraspConfig()
    ranges: TactileRanges = TactileRanges()
