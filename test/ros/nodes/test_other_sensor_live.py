# SPDX-License-Identifier: Apache-2.0
"""Predictions of a uSkin: topic, markers, screen and picture."""

from argparse import Namespace

import numpy as np
import pytest
from calibrated_models import make_calibration
from constant_models import constant_model, counted
from contact_model_builders import can_with_grasps
from rich.console import Console
from visualization_msgs.msg import MarkerArray

from foretouch.cli.answers import answer_record
from foretouch.cli.live import live_panel
from foretouch.cli.run import _draw
from foretouch.errors import ModelError
from foretouch.ros.messages.conversions import prediction_from_msg
from foretouch.ros.nodes.monitor import MonitorNode
from foretouch.tactile.description import packaged_sensor
from foretouch.types import ASSUMED_TABLE
from foretouch.types.scene import Object

pytestmark = pytest.mark.ros


def test_another_sensor_is_drawn_and_shown_with_its_intervals_but_does_not_adapt_to_a_biotac(
    graph, predictor, monkeypatch, tmp_path
):
    sensor = packaged_sensor("xela_uskin_4x4")
    calibration = make_calibration(0, sensor.channels, counted(sensor))
    model = constant_model(sensor, counted(sensor), calibration)
    monkeypatch.setattr("foretouch.ros.steps.predictor.load_model", lambda *_: model)
    monitor = MonitorNode(sensor=sensor)
    graph.serve(monitor)
    node, send, _ = predictor()
    markers = graph.listen(MarkerArray, "markers")
    graph.matched("markers", "touch")
    send(9)
    graph.until(lambda: markers and monitor.view().answers)
    spheres = {marker.ns: len(marker.points) for marker in markers[0].markers if marker.type == marker.SPHERE_LIST}
    assert spheres == {"thumb": 16, "FF": 16}
    assert dict(monitor.view().answers) == {"ok": 1}
    (one,) = monitor.view().last.predictions
    found = prediction_from_msg(one, sensor)
    np.testing.assert_array_equal(found.value.values, counted(sensor).astype(np.float32))
    half = calibration.unread_half_widths["known"]
    np.testing.assert_allclose(found.upper.values - found.value.values, half, atol=0.01)
    with pytest.raises(ModelError, match=r"xela_uskin_4x4 .* is not biotac_sp"):
        prediction_from_msg(one)
    (record,) = answer_record(monitor.view().last, sensor)["predictions"]
    read = np.concatenate([np.ravel(record[name]["value"]) for name in sensor.channels.modalities])
    np.testing.assert_array_equal(read, found.value.values)
    console = Console(width=120, color_system=None)
    with console.capture() as shown:
        console.print(live_panel(monitor.view(), "title"))
    for words in ("Z_TH", "Z_FF", "±", "last prediction (counts) by constant"):
        assert words in shown.get()
    target = Object.of("1", can_with_grasps(1)[0], ASSUMED_TABLE)
    _draw([(None, target, one, None)], Namespace(picture=str(tmp_path / "a.png"), model=None, predictor=None), sensor)
    assert (tmp_path / "a.png").stat().st_size > 10_000
    (warning,) = [text for text in node.reported().warnings if "adapt" in text]
    assert "/rh/tactile: is of biotac_sp" in warning
    assert "not xela_uskin_4x4" in warning
    assert node.reported().values["regime"] == warning
