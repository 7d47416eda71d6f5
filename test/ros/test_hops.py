# SPDX-License-Identifier: Apache-2.0
"""How many functions a cloud passes through on its way from the subscription to the model."""

import threading
import traceback
from pathlib import Path

import pytest
from sensor_msgs.msg import PointCloud2

import foretouch
from foretouch.base.bounded_queue import BoundedQueue
from foretouch.models.contact.estimator import ContactEstimator
from foretouch.ros.messages.clouds import cloud_to_msg
from foretouch_msgs.msg import TouchPredictionArray

pytestmark = pytest.mark.ros

HOUSE = str(Path(foretouch.__file__).parent)


def frames() -> list[str]:
    """Functions of the package that are running in this thread, outermost first."""
    stack = [frame.f_code for frame, _ in traceback.walk_stack(None)]
    return [code.co_qualname for code in reversed(stack) if code.co_filename.startswith(HOUSE)]


def test_at_most_ten_functions_are_between_the_callback_and_the_model(graph, scene_cloud, monkeypatch):
    put, estimate, seen = BoundedQueue.put, ContactEstimator.estimate, {}

    def watched_put(queue, item):
        seen.setdefault(threading.current_thread().name, frames())
        return put(queue, item)

    def watched_estimate(model, *arguments):
        seen[threading.current_thread().name] = frames()
        return estimate(model, *arguments)

    monkeypatch.setattr(BoundedQueue, "put", watched_put)
    monkeypatch.setattr(ContactEstimator, "estimate", watched_estimate)
    (node,) = graph.add("perception")
    touch = graph.listen(TouchPredictionArray, "touch")
    points = graph.talk_matched(PointCloud2, "points")
    graph.matched("touch")
    seen.clear()
    points.publish(cloud_to_msg(scene_cloud(stamp_ns=1)))
    graph.until(lambda: touch)
    assert touch[0].predictions
    worker = seen.pop(node.get_name())
    (callback,) = (stack for stack in seen.values() if stack)
    callback = callback[next(k for k, name in enumerate(callback) if name.endswith("._take")) :]
    passed = [*callback, "BoundedQueue.put", *worker]
    assert worker[-2:] == ["TouchModel.predict", "TouchModel._estimate"]
    assert len(passed) <= 10, passed
