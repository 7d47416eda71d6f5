# SPDX-License-Identifier: Apache-2.0
"""Beside a busy core, of more clouds than a graph can answer, the newest are answered, and all are accounted for."""

import subprocess
import sys
import time

import numpy as np
import pytest
from sensor_msgs.msg import PointCloud2

from foretouch.ros.messages.clouds import cloud_to_msg
from foretouch.ros.messages.conversions import stamp_to_msg
from foretouch.types import stamp_ns
from foretouch_msgs.msg import TouchPredictionArray

pytestmark = [pytest.mark.ros, pytest.mark.slow]
SECONDS = 6.0


@pytest.fixture
def busy_core():
    """Another process that takes all of a core."""
    process = subprocess.Popen([sys.executable, "-c", "while True: pass"])
    yield
    process.kill()
    process.wait()


def sent(graph, message, rate_hz):
    """Publish a cloud again and again; the stamps, and the time of each answer by its stamp [ns], which goes on."""
    arrived = {}
    graph.probe.create_subscription(
        TouchPredictionArray, "touch", lambda m: arrived.update({stamp_ns(m.header.stamp): time.time_ns()}), 100
    )
    publisher = graph.talk_matched(PointCloud2, "points")
    graph.matched("touch")
    begin, stamps = time.monotonic(), []
    for number in range(round(rate_hz * SECONDS)):
        time.sleep(max(0.0, begin + number / rate_hz - time.monotonic()))
        stamps.append(time.time_ns())
        message.header.stamp = stamp_to_msg(stamps[-1])
        publisher.publish(message)
    return stamps, arrived


@pytest.mark.parametrize("work_ms", [25.0, 80.0])
def test_beyond_what_it_can_do_the_graph_answers_the_newest_cloud(
    graph, scene_cloud, model_card, monkeypatch, busy_core, work_ms
):
    (node,) = graph.add("perception", model=model_card)
    predict = node._touch.predictor.predict

    def slowly(*arguments, **options):
        time.sleep(work_ms / 1e3)
        return predict(*arguments, **options)

    monkeypatch.setattr(node._touch.predictor, "predict", slowly)
    rate_hz = 60.0
    stamps, ages = sent(graph, cloud_to_msg(scene_cloud(width=160)), rate_hz)
    graph.until(lambda: node.statistics.summary().received + node.statistics.summary().lost == len(stamps))
    graph.until(lambda: node.statistics.summary().waiting == 0)
    graph.until(lambda: len(ages) == node.statistics.summary().used)
    now = node.statistics.summary()
    assert now.received == now.used + now.dropped["superseded"]
    assert set(now.dropped) == {"superseded"}
    # It was the newest when the answer before was done, but for some that were on their way.
    answered = np.array([(stamp, arrived) for stamp, arrived in sorted(ages.items()) if stamp > stamps[0] + 1e9])
    newest = np.searchsorted(stamps, answered[:-1, 1]) - 1
    behind = newest - np.searchsorted(stamps, answered[1:, 0])
    assert np.median(behind) <= 7, np.percentile(behind, (50, 90))
