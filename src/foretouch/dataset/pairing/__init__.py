# SPDX-License-Identifier: Apache-2.0
"""Which touch belongs to which grasp, and which grasp to which cloud: by header stamps and ids, never by arrival."""

from foretouch.dataset.pairing.contact_episodes import ContactEpisodes, Episode
from foretouch.dataset.pairing.cut import Interval, PairingConfig, PairingError, TouchCut, cut_touch
from foretouch.dataset.pairing.grasp_book import GraspBook
from foretouch.dataset.pairing.kept_clouds import KeptCloud, KeptClouds
from foretouch.dataset.pairing.linked import CountedOut, Execution, Label, Linked, Plan
from foretouch.dataset.pairing.sensor_health import ALIVE, NO_DATA, SensorHealth
from foretouch.dataset.pairing.touch_buffer import TouchBuffer, TouchReading

__all__ = [
    "ALIVE",
    "NO_DATA",
    "ContactEpisodes",
    "CountedOut",
    "Episode",
    "Execution",
    "GraspBook",
    "Interval",
    "KeptCloud",
    "KeptClouds",
    "Label",
    "Linked",
    "PairingConfig",
    "PairingError",
    "Plan",
    "SensorHealth",
    "TouchBuffer",
    "TouchCut",
    "TouchReading",
    "cut_touch",
]
