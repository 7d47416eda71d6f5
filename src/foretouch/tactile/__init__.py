# SPDX-License-Identifier: Apache-2.0
"""The BioTac SP: modalities, ranges, units, electrode layout, validity and tare."""

from foretouch.tactile.layout import electrode_normals, electrode_positions
from foretouch.tactile.modalities import MODALITIES, columns, modality_size
from foretouch.tactile.ranges import P1_RANGES, P2_RANGES, TactileRanges, load_ranges
from foretouch.tactile.tare import make_tare, offsets, restore
from foretouch.tactile.units import FULL_SCALE, to_celsius, to_kohm, to_kpa, to_pa
from foretouch.tactile.validity import TouchCheck, check_series, check_touch

__all__ = [
    "FULL_SCALE",
    "MODALITIES",
    "P1_RANGES",
    "P2_RANGES",
    "TactileRanges",
    "TouchCheck",
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
