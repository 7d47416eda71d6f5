# SPDX-License-Identifier: Apache-2.0
"""Inputs are taken and worked on in one thread, and by another while that takes long."""

import threading
import time

import pytest
from sensor_msgs.msg import PointCloud2

from foretouch.pipeline import FoundObject, Pipeline
from foretouch.ros.messages.clouds import objects_to_msg
from foretouch.ros.messages.conversions import grasp_to_msg, header_to_msg
from foretouch.ros.runtime.processing_node import warm_up_cloud
from foretouch.types import ASSUMED_TABLE
from foretouch_msgs.msg import GraspArray, TablePlane, TouchPredictionArray

pytestmark = pytest.mark.ros


@pytest.fixture
def predictor(graph, model_card):
    """A touch predictor, a function that sends it a cloud with grasps, and its answers."""
    (node,) = graph.add("touch_predictor", model=model_card)
    heard = graph.listen(TouchPredictionArray, "touch")
    clouds, grasps = graph.talk(PointCloud2, "object_cloud"), graph.talk(GraspArray, "grasps")
    graph.matched("object_cloud", "grasps", "touch")
    target = Pipeline().segment(warm_up_cloud()).targets[0]
    planned = [grasp_to_msg(one) for one in Pipeline().plan(target).grasps]

    def send(stamp):
        message = objects_to_msg([FoundObject("1", target.cloud, ASSUMED_TABLE)], "cam", stamp)
        clouds.publish(message)
        grasps.publish(GraspArray(header=message.header, grasps=planned))

    return node, send, heard


def slowed(monkeypatch, node, seconds, begun=None):
    """Note the threads that predict, and let each prediction take longer."""
    threads, original = [], node._predictor.array

    def predict(*args, **kwargs):
        threads.append(threading.current_thread().name)
        if begun is not None:
            begun.set()
        time.sleep(seconds)
        return original(*args, **kwargs)

    monkeypatch.setattr(node._predictor, "array", predict)
    return threads


def test_a_request_is_answered_in_the_thread_that_takes_it(graph, predictor, monkeypatch):
    node, send, heard = predictor
    threads = slowed(monkeypatch, node, 0.0)
    for stamp in (1, 2, 3):
        send(stamp)
        graph.until(lambda stamp=stamp: len(heard) == stamp)
    assert threads == ["inputs"] * 3


def test_messages_are_taken_while_an_answer_takes_long(graph, predictor, monkeypatch):
    node, send, heard = predictor
    tables = graph.talk(TablePlane, "table")
    graph.matched("table")
    begun = threading.Event()
    slowed(monkeypatch, node, 1.0, begun)
    send(1)
    assert begun.wait(5.0)
    for stamp in (2, 3):
        tables.publish(TablePlane(header=header_to_msg("cam", stamp)))
        graph.until(lambda stamp=stamp: stamp in node._tables, timeout_s=0.8)
    assert not heard
    monkeypatch.undo()
    for stamp in (4, 5):  # of the queue, in order
        send(stamp)
    graph.until(lambda: len(heard) == 3)
    assert [one.header.stamp.nanosec for one in heard] == [1, 4, 5]
    summary = node.statistics.summary()
    assert (summary.received, summary.used, summary.lost) == (3, 3, 0)
