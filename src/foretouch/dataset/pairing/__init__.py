# SPDX-License-Identifier: Apache-2.0
"""Pairing of tactile readings with grasps, and of grasps with clouds: by header stamps and ids, never by arrival."""

from foretouch.dataset.pairing.assembler import AssembledSample, AssemblerConfig, Role, SampleAssembler
from foretouch.dataset.pairing.buffers import SerializedCloud, TouchBuffer, TouchReading
from foretouch.dataset.pairing.cut import Interval, PairingConfig, PairingError, TouchCut, cut_touch
from foretouch.dataset.pairing.matcher import ExecutedGrasp, Label, RejectedGrasp

__all__ = [
    "AssembledSample",
    "AssemblerConfig",
    "ExecutedGrasp",
    "Interval",
    "Label",
    "PairingConfig",
    "PairingError",
    "RejectedGrasp",
    "Role",
    "SampleAssembler",
    "SerializedCloud",
    "TouchBuffer",
    "TouchCut",
    "TouchReading",
    "cut_touch",
]
