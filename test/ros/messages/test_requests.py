# SPDX-License-Identifier: Apache-2.0
"""What other nodes send is read, or refused with a status and a reason in one line."""

import numpy as np
import pytest
from every_case import every_case
from shape_msgs.msg import Plane

from foretouch.cli.answers import answer_record
from foretouch.errors import ModelError
from foretouch.ros.messages.conversions import (
    grasp_to_msg,
    header_to_msg,
    prediction_from_msg,
    prediction_to_msg,
    reference_text,
    refusal_to_msg,
)
from foretouch.ros.messages.requests import RefusalError, read_table
from foretouch.types import Grasp, Touch, TouchPrediction
from foretouch_msgs.msg import Status, TablePlane, TouchPredictionArray

HEADER = header_to_msg("camera", 5)
GRASP = Grasp(np.array([0.03, 0, 0.6]), np.array([-0.03, 0, 0.6]), np.eye(3), 1.0, "1", "7")


def test_a_table_that_was_not_found_is_refused_with_a_reason():
    def check(status, reason, refused_as, text):
        with pytest.raises(RefusalError) as refusal:
            read_table(TablePlane(header=HEADER, plane=Plane(), status=status, reason=reason), HEADER)
        assert (refusal.value.status, refusal.value.reason) == (refused_as, text)

    cases = [
        (Status.NO_PLANE, "no plane", Status.NO_PLANE, "no plane"),
        (Status.NO_PLANE, "", Status.NO_PLANE, "table: status no_plane without a reason"),
        (250, "", Status.BAD_REQUEST, "table: status 250 is unknown"),
        (Status.NO_OBJECT, "a\nb", Status.NO_OBJECT, r"a\nb"),
    ]
    every_case(cases, check)


def test_a_prediction_with_an_unknown_reference_is_refused_and_still_printed():
    prediction = TouchPrediction(grasp=GRASP, value=Touch.from_vector(np.full(50, 2000.0)), lower=None, upper=None)
    good, strange = (prediction_to_msg(prediction, grasp_to_msg(GRASP), HEADER) for _ in range(2))
    strange.reference = 77
    reason = "reference: 77 is none of none, tare, touches, history"
    with pytest.raises(ModelError, match=reason):
        prediction_from_msg(strange)
    assert reference_text(strange) == "reference 77"
    bad = grasp_to_msg(GRASP)
    bad.g1.x = float("nan")
    refused = refusal_to_msg(bad, HEADER, Status.BAD_GRASP, "g1: is not finite")
    lines = answer_record(TouchPredictionArray(header=HEADER, predictions=[good, strange, refused]))["predictions"]
    assert lines[0]["status"] == "ok"
    assert lines[1:] == [{"status": "failed", "reason": reason}, {"status": "bad_grasp", "reason": "g1: is not finite"}]
