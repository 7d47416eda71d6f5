# SPDX-License-Identifier: Apache-2.0
"""The hard scenes through a running node over real DDS; changed requests are in `test_fuzz.py`."""

import re

import numpy as np
import pytest
from corpus.clouds import scene_cases
from every_case import every_case
from sensor_msgs.msg import PointCloud2
from visualization_msgs.msg import MarkerArray

from foretouch.ros.messages.clouds import cloud_to_msg
from foretouch.ros.messages.conversions import header_to_msg
from foretouch.ros.messages.requests import status_name
from foretouch.ros.runtime.processing_node import warm_up_cloud
from foretouch.types import Cloud, stamp_ns
from foretouch_msgs.msg import GraspArray, ObjectArray, Status, TablePlane, TouchPredictionArray

pytestmark = [pytest.mark.ros, pytest.mark.slow, pytest.mark.timeout(600)]

OUTPUTS = {"objects": ObjectArray, "table": TablePlane, "grasps": GraspArray, "markers": MarkerArray}
SCENES = {case.name: case for case in scene_cases() if case.cloud.size <= 200_000}


def numbers(prediction):
    """All numbers of a prediction to their last bit, without stamps."""
    contacts = [value for p in (prediction.grasp.g1, prediction.grasp.g2) for value in (p.x, p.y, p.z)]
    values = [*prediction.scalars, *prediction.values, *prediction.lower, *prediction.upper]
    return np.array([*values, *contacts, *prediction.grasp.rotation]).tobytes()


def test_each_has_an_answer_without_nan_or_a_named_refusal_and_changes_no_later_answer(graph):
    (node,) = graph.add("perception", grasp_hold=0.0, silence_s=1e6, late_after_s=0.0)
    heard = {topic: graph.listen(kind, topic) for topic, kind in OUTPUTS.items()}
    answers, clouds = graph.listen(TouchPredictionArray, "touch"), graph.talk(PointCloud2, "points")
    graph.matched("points", "touch", *OUTPUTS)
    last_ns = 1_700_000_000_000_000_000

    def answer(cloud):
        nonlocal last_ns
        last_ns += 1_000_000
        message = cloud_to_msg(cloud)
        message.header = header_to_msg("camera", last_ns)
        clouds.publish(message)
        graph.until(lambda: answers and stamp_ns(answers[-1].header.stamp) == last_ns, 20.0)
        return answers[-1]

    def check(case):
        touch = answer(Cloud(case.cloud.xyz))
        told = status_name(touch.status), touch.reason
        if case.segmented != "ok":
            assert told[0] == case.segmented, told
            assert re.search(case.reason, touch.reason), told
            assert not touch.predictions
            return
        assert touch.status in (Status.OK, Status.INITIAL_POINTS), told
        assert touch.predictions
        for prediction in touch.predictions:
            finite = np.isfinite([*prediction.scalars, *prediction.values]).all()
            assert finite if prediction.status == Status.OK else prediction.reason

    (before, *_) = answer(warm_up_cloud()).predictions
    assert before.status == Status.OK
    every_case(SCENES, check)
    assert numbers(answer(warm_up_cloud()).predictions[0]) == numbers(before)
    assert (node.internal_errors.counts(), node.state_name) == ({}, "active")
    for message in (message for messages in heard.values() for message in messages):
        assert not re.search(r"(?<!score=)\b(nan|inf)\b", str(message))
