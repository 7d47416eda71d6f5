# SPDX-License-Identifier: Apache-2.0
# Alias until merge.
from foretouch.dataset.record import (
    APPROACH,
    DISCARDED,
    HOLD,
    REST,
    Identity,
    Outcome,
    SampleRecord,
    TouchSeries,
    check_id,
    check_name,
)

__all__ = [
    "APPROACH",
    "DISCARDED",
    "HOLD",
    "REST",
    "Identity",
    "Outcome",
    "SampleRecord",
    "TouchSeries",
    "check_id",
    "check_name",
]
