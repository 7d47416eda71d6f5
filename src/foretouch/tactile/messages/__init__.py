# SPDX-License-Identifier: Apache-2.0
"""Decoders of tactile messages, one module for each type; they accept messages of rclpy and of rosbags alike."""

from foretouch.tactile.messages.table import (
    ARRIVAL_STAMPED,
    TACTILE_TYPES,
    TactileConfig,
    TactileReader,
    TactileReading,
    make_reader,
    stamp_ns,
)

__all__ = [
    "ARRIVAL_STAMPED",
    "TACTILE_TYPES",
    "TactileConfig",
    "TactileReader",
    "TactileReading",
    "make_reader",
    "stamp_ns",
]
