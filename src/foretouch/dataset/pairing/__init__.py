# SPDX-License-Identifier: Apache-2.0
"""Pairing of tactile readings with grasps, and of grasps with clouds: by header stamps and ids, never by arrival."""

from foretouch.dataset.pairing.assembler import AssembledSample, AssemblerConfig, Role, SampleAssembler
from foretouch.dataset.pairing.buffers import (
    BufferedCloud,
    CloudBuffer,
    SerializedCloud,
    TouchBuffer,
    TouchReading,
    TouchWindow,
)
from foretouch.dataset.pairing.cut import Interval, PairingConfig, PairingError, TouchCut, cut_touch
from foretouch.dataset.pairing.matcher import (
    ExecutedGrasp,
    GraspTouchMatcher,
    Label,
    MatchedGrasp,
    PlannedGrasps,
    RejectedGrasp,
)
from foretouch.dataset.pairing.sensors import ALIVE, NO_DATA, ContactEpisodes, Episode, SensorHealth

__all__ = [
    "ALIVE",
    "NO_DATA",
    "AssembledSample",
    "AssemblerConfig",
    "BufferedCloud",
    "CloudBuffer",
    "ContactEpisodes",
    "Episode",
    "ExecutedGrasp",
    "GraspTouchMatcher",
    "Interval",
    "Label",
    "MatchedGrasp",
    "PairingConfig",
    "PairingError",
    "PlannedGrasps",
    "RejectedGrasp",
    "Role",
    "SampleAssembler",
    "SensorHealth",
    "SerializedCloud",
    "TouchBuffer",
    "TouchCut",
    "TouchReading",
    "TouchWindow",
    "cut_touch",
]
