# SPDX-License-Identifier: Apache-2.0
"""Parts of the examples that need no running graph."""

import importlib.util
import math
import sys
from pathlib import Path

import numpy as np
import pytest
from answer_builders import touch_message
from rclpy.duration import Duration

from foretouch.ros.messages.conversions import grasp_to_msg
from foretouch.tactile import biotac_touch
from foretouch.types import Grasp
from foretouch.types import TouchPrediction as Predicted
from foretouch_msgs.msg import TouchPrediction, TouchPredictionArray

pytestmark = pytest.mark.ros

EXAMPLES = Path(__file__).parents[2] / "examples"


def example(name):
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    module = sys.modules[name] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_listener_describes_each_reference_and_discards_old_answers_by_their_stamps(graph, capsys):
    listen, grasp = example("listen_touch"), Grasp(np.zeros(3), np.ones(3), np.eye(3))
    for name in ("NONE", "TARE", "TOUCHES", "HISTORY"):
        predicted = Predicted(grasp, biotac_touch(np.full(50, 3000.0)))
        prediction = touch_message(predicted, grasp_to_msg(grasp))
        prediction.reference = getattr(TouchPrediction, name)
        assert "TH PDC 3000, E 3000 (3000 to 3000)" in listen.describe(prediction)
        assert "based on" in listen.describe(prediction)
    (node,) = graph.add("grasp")
    publisher = node.advertise(TouchPredictionArray, "touch", keep=True)
    publisher.on_activate(None)
    now = node.get_clock().now()
    for age_s in (60.0, 50.0, 2.0, 1.0):
        message = TouchPredictionArray(reason=f"{age_s:g} s old")
        message.header.stamp = (now - Duration(seconds=age_s)).to_msg()
        publisher.publish(message)
    listeners = [listen.TouchListener("/foretouch/touch", age_s) for age_s in (30.0, math.inf)]
    graph.serve(*listeners)
    graph.until(lambda: [one.received for one in listeners] == [2, 4])
    assert [one.discarded for one in listeners] == [2, 0]
    assert capsys.readouterr().out.count("60 s old") == 1
