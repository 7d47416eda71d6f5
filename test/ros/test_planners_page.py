# SPDX-License-Identifier: Apache-2.0
"""What docs/planners.md states: its commands run, and it explains every status, flag and rule of costs."""

from pathlib import Path

import pytest

from foretouch.ros.steps.touch_settings import COSTS
from foretouch_msgs.msg import Status, TouchPrediction

pytestmark = pytest.mark.ros

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "planners.md").read_text(encoding="utf-8")


def test_every_status_reference_flag_and_rule_is_explained():
    statuses = [name for name in dir(Status) if name.isupper() and isinstance(getattr(Status, name), int)]
    references = ["NONE", "TARE", "TOUCHES", "HISTORY"]
    assert all(hasattr(TouchPrediction, name) for name in references)
    flags = [
        "out_of_range",
        "unfamiliar",
        "similar_touches",
        "equal_pressure",
        "late",
        "fallback_model",
        "ambiguous_target",
        "unknown_frame",
    ]
    missing = [name for name in (*statuses, *references, *flags, *COSTS) if f"`{name}`" not in PAGE]
    assert (len(statuses) > 15, missing) == (True, [])
