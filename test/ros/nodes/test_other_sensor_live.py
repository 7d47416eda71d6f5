# SPDX-License-Identifier: Apache-2.0
"""Predictions of a uSkin: topic and markers; the service and the action are those of any sensor."""

import numpy as np
import pytest
from calibrated_models import make_calibration
from constant_models import constant_model, counted
from visualization_msgs.msg import MarkerArray

from foretouch.errors import ModelError
from foretouch.ros.messages.conversions import prediction_from_msg
from foretouch.ros.nodes.monitor import MonitorNode
from foretouch.tactile.description import packaged_sensor

pytestmark = pytest.mark.ros


def test_another_sensor_is_drawn_and_has_its_intervals_but_does_not_adapt_to_a_biotac(graph, predictor, monkeypatch):
    sensor = packaged_sensor("xela_uskin_4x4")
    calibration = make_calibration(0, sensor.channels, counted(sensor))
    model = constant_model(sensor, counted(sensor), calibration)
    monkeypatch.setattr("foretouch.ros.touch.predictor.load_model", lambda _: model)
    monitor = MonitorNode(sensor=sensor)
    graph.serve(monitor)
    node, send, _ = predictor()
    markers = graph.listen(MarkerArray, "markers")
    graph.matched("markers", "touch")
    send(9)
    graph.until(lambda: markers and monitor.view().answers)
    spheres = {one.ns: len(one.points) for one in markers[0].markers if one.type == one.SPHERE_LIST}
    assert spheres == {"thumb": 16, "FF": 16}
    assert dict(monitor.view().answers) == {"ok": 1}
    (one,) = monitor.view().last.predictions
    found = prediction_from_msg(one, sensor)
    np.testing.assert_array_equal(found.value.values, counted(sensor).astype(np.float32))
    half = calibration.unread_half_widths["known"]
    np.testing.assert_allclose(found.upper.values - found.value.values, half, atol=0.01)
    with pytest.raises(ModelError, match=r"xela_uskin_4x4 .* is not biotac_sp"):
        prediction_from_msg(one)
    (warning,) = [text for text in node.warnings() if "adapt" in text]
    assert "/rh/tactile: is of biotac_sp" in warning
    assert "not xela_uskin_4x4" in warning
    assert node.notes()["regime"] == warning
