# SPDX-License-Identifier: Apache-2.0
"""The BioTac SP: modalities, ranges, electrode positions, validity, tare, units and contact detection."""

from foretouch.tactile.channels import (
    MODALITIES,
    P1_RANGES,
    P2_RANGES,
    TactileRanges,
    columns,
    electrode_normals,
    electrode_positions,
    load_ranges,
    modality_size,
)
from foretouch.tactile.readings import (
    CONSTANT_SAMPLES,
    FULL_SCALE,
    TouchValidity,
    check_series,
    check_touch,
    make_tare,
    offsets,
    restore,
    to_celsius,
    to_kohm,
    to_kpa,
    to_pa,
)

__all__ = [
    "CONSTANT_SAMPLES",
    "FULL_SCALE",
    "MODALITIES",
    "P1_RANGES",
    "P2_RANGES",
    "TactileRanges",
    "TouchValidity",
    "check_series",
    "check_touch",
    "columns",
    "electrode_normals",
    "electrode_positions",
    "load_ranges",
    "make_tare",
    "modality_size",
    "offsets",
    "restore",
    "to_celsius",
    "to_kohm",
    "to_kpa",
    "to_pa",
]
