# SPDX-License-Identifier: Apache-2.0
"""Tactile sensors: descriptions, messages, ranges, validity, tare and contact detection; and the BioTac SP."""

from foretouch.tactile.channels import (
    BIOTAC,
    BIOTAC_SP,
    ELECTRODES,
    MODALITIES,
    P1_RANGES,
    P2_RANGES,
    TOUCH_SIZE,
    Ranges,
    TactileRanges,
    biotac_touch,
    usual_ranges,
)
from foretouch.tactile.readings import FULL_SCALE, is_tdc, make_tare, tdc_of, to_kohm, touch_faults

__all__ = [
    "BIOTAC",
    "BIOTAC_SP",
    "ELECTRODES",
    "FULL_SCALE",
    "MODALITIES",
    "P1_RANGES",
    "P2_RANGES",
    "TOUCH_SIZE",
    "Ranges",
    "TactileRanges",
    "biotac_touch",
    "is_tdc",
    "make_tare",
    "tdc_of",
    "to_kohm",
    "touch_faults",
    "usual_ranges",
]
