# SPDX-License-Identifier: Apache-2.0
"""Which touch belongs to which grasp, and which grasp to which cloud: by header stamps and ids, never by arrival."""

from foretouch.dataset.pairing.cloud_buffer import BufferedCloud, CloudBuffer
from foretouch.dataset.pairing.contact_episodes import ContactEpisodes, Episode
from foretouch.dataset.pairing.cut import Interval, PairingConfig, PairingError, TouchCut, cut_touch
from foretouch.dataset.pairing.matcher import GraspTouchMatcher
from foretouch.dataset.pairing.matches import Execution, Label, MatchedGrasp, Plan, RejectedGrasp
from foretouch.dataset.pairing.sensor_health import ALIVE, NO_DATA, SensorHealth
from foretouch.dataset.pairing.touch_buffer import TouchBuffer, TouchReading

__all__ = [
    "ALIVE",
    "NO_DATA",
    "BufferedCloud",
    "CloudBuffer",
    "ContactEpisodes",
    "Episode",
    "Execution",
    "GraspTouchMatcher",
    "Interval",
    "Label",
    "MatchedGrasp",
    "PairingConfig",
    "PairingError",
    "Plan",
    "RejectedGrasp",
    "SensorHealth",
    "TouchBuffer",
    "TouchCut",
    "TouchReading",
    "cut_touch",
]
