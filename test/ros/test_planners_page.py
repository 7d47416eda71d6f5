# SPDX-License-Identifier: Apache-2.0
"""What docs/planners.md states: its commands run, and it explains every status, flag and rule of costs."""

import re
from pathlib import Path

import pytest

from foretouch.cloud.segmentation.objects import AMBIGUOUS_TARGET
from foretouch.grasp.carry import CANNOT_CARRY
from foretouch.grasp.completed import MAY_NOT_FIT
from foretouch.grasp.reach import OFF_OBJECT
from foretouch.grasp.unseen import BESIDE_UNSEEN
from foretouch.models.equal_pressure import EQUAL_PRESSURE
from foretouch.models.predictor import UNFAMILIAR
from foretouch.models.touch_model import NO_TABLE, SIMILAR_TOUCHES
from foretouch.ros.steps.touch_settings import COSTS
from foretouch.stream import SELECTED
from foretouch.types import LATE, UNKNOWN_FRAME
from foretouch_msgs.msg import Status, TouchPrediction

pytestmark = pytest.mark.ros

ROOT = Path(__file__).parents[2]
FLAGS = (
    *("out_of_range", "unfamiliar", *UNFAMILIAR, SIMILAR_TOUCHES, EQUAL_PRESSURE, OFF_OBJECT, BESIDE_UNSEEN),
    *(MAY_NOT_FIT, CANNOT_CARRY, NO_TABLE, LATE, "fallback_model", AMBIGUOUS_TARGET, SELECTED, UNKNOWN_FRAME),
)
PAGE = (ROOT / "docs" / "planners.md").read_text(encoding="utf-8")


def test_every_status_reference_flag_and_rule_is_explained():
    statuses = [name for name in dir(Status) if name.isupper() and isinstance(getattr(Status, name), int)]
    references = ["NONE", "TARE", "TOUCHES", "HISTORY"]
    assert all(hasattr(TouchPrediction, name) for name in references)
    missing = [name for name in (*statuses, *references, *FLAGS, *COSTS) if f"`{name}`" not in PAGE]
    assert (len(statuses) > 15, missing) == (True, [])


def test_the_message_lists_every_flag():
    listed = (ROOT / "foretouch_msgs" / "msg" / "TouchPrediction.msg").read_text(encoding="utf-8")
    assert [flag for flag in FLAGS if not re.search(rf"\b{flag}\b", listed)] == []
