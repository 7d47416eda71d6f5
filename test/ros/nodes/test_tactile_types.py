# SPDX-License-Identifier: Apache-2.0
"""A type of tactile messages that was added to the table is recorded, and adapted to."""

import numpy as np
import pytest
from calibrated_models import save_calibrated_network
from geometry_msgs.msg import Point32, Polygon, PolygonStamped
from pair_builders import level
from robot_builders import QUICK, Robot
from tactile_type_builder import MADE_UP_TYPE, add_tactile_type

from foretouch.dataset.recordings.reader import RecordedDataset
from foretouch.ros.messages.conversions import header_to_msg

pytestmark = pytest.mark.ros


class OtherHand(Robot):
    tactile = PolygonStamped

    def message(self, counts):
        rows = np.r_[counts, 0].reshape(17, 3).astype(float)
        points = [Point32(x=x, y=y, z=z) for x, y, z in rows.tolist()]
        return PolygonStamped(header=header_to_msg("rh", self.now), polygon=Polygon(points=points))


def test_recorder_and_touch_predictor_accept_it(graph, tmp_path, monkeypatch):
    add_tactile_type(monkeypatch)
    card = save_calibrated_network(tmp_path)
    (recorder,) = graph.add("recorder", record=str(tmp_path / "set"), tactile__type=MADE_UP_TYPE, **QUICK)
    (predictor,) = graph.add("touch_predictor", model=card, tactile__type=MADE_UP_TYPE, **QUICK)
    assert recorder.describe_parameter("tactile.type").additional_constraints.endswith(MADE_UP_TYPE)
    hand = OtherHand(graph)
    graph.matched("/rh/tactile", subscribers=2)
    hand.grasp("g", 0)
    graph.until(lambda: recorder.status().samples == 1)
    graph.until(lambda: predictor.reported().values["tactile.received"] == str(hand.sent["/rh/tactile"]))
    assert predictor.reported().values["tactile.unreadable"] == "0"
    recorder.end()
    dataset = RecordedDataset(tmp_path / "set")
    one = dataset[0]
    np.testing.assert_allclose(one.touch.values, level(0), atol=5.0)
    names = {"tactile": MADE_UP_TYPE, "thumb": "thumb", "middle_finger": "middle"}
    assert {key: dataset.identity.hand[key] for key in names} == names
