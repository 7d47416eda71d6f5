# SPDX-License-Identifier: Apache-2.0
"""The BioTac SP: modalities, ranges, electrode positions, validity, tare and contact detection."""

from foretouch.tactile.channels import (
    MODALITIES,
    P1_RANGES,
    P2_RANGES,
    TactileRanges,
    columns,
    electrode_normals,
    electrode_positions,
    modality_size,
)
from foretouch.tactile.readings import FULL_SCALE, is_tdc, make_tare, offsets, restore, tdc_of, to_kohm, touch_faults

__all__ = [
    "FULL_SCALE",
    "MODALITIES",
    "P1_RANGES",
    "P2_RANGES",
    "TactileRanges",
    "columns",
    "electrode_normals",
    "electrode_positions",
    "is_tdc",
    "make_tare",
    "modality_size",
    "offsets",
    "restore",
    "tdc_of",
    "to_kohm",
    "touch_faults",
]
