# SPDX-License-Identifier: Apache-2.0
import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus

from foretouch.ros.runtime.diagnostics import InputStatistics, NodeStatus, diagnostic_status


def values(status):
    return {pair.key: pair.value for pair in status.values}


def test_every_input_is_accounted_for():
    statistics = InputStatistics()
    arrivals = [statistics.receive() for _ in range(10)]
    for arrived in arrivals[:6]:
        statistics.use(arrived, 0.1)
    statistics.drop("superseded")
    statistics.drop("superseded")
    statistics.drop("inactive")
    now = statistics.summary()
    assert (now.received, now.used, now.waiting) == (10, 6, 1)
    assert now.dropped == {"superseded": 2, "inactive": 1}
    assert now.received == now.used + sum(now.dropped.values()) + now.waiting


def test_quantiles_are_those_of_numpy():
    statistics = InputStatistics()
    ages = np.arange(1, 101) / 1000.0
    for age in ages:
        statistics.use(statistics.receive(), float(age))
    p50, p95 = statistics.summary().input_age_ms
    np.testing.assert_allclose([p50, p95], np.percentile(ages * 1e3, [50, 95]))


def test_nothing_is_made_up_before_the_first_input():
    now = InputStatistics().summary()
    assert now.latency_ms is None
    assert now.idle_s is None
    assert now.rate_hz == 0.0


def test_silence_is_a_warning_only_where_inputs_are_expected_and_the_node_is_active():
    now = InputStatistics().summary()
    silent = diagnostic_status("n", now, None, NodeStatus(state="active", expects_input_every_s=5.0))
    assert silent.level == DiagnosticStatus.WARN
    assert silent.message == "no input yet"
    for node in (NodeStatus(state="active"), NodeStatus(state="inactive", expects_input_every_s=5.0)):
        assert diagnostic_status("n", now, None, node).level == DiagnosticStatus.OK


def test_drops_are_told_once_with_their_reasons():
    statistics = InputStatistics()
    before = statistics.summary()
    statistics.receive()
    statistics.drop("superseded")
    statistics.lose(3)
    now = statistics.summary()
    status = diagnostic_status("n", now, before, NodeStatus(state="active"))
    assert status.message == "dropped: 1 superseded, 3 lost in transport"
    assert values(status)["dropped.superseded"] == "1"
    assert values(status)["lost_on_the_way"] == "3"
    assert diagnostic_status("n", now, now, NodeStatus(state="active")).level == DiagnosticStatus.OK


def test_an_error_outweighs_warnings():
    now = InputStatistics().summary()
    node = NodeStatus(state="active", errors=("model: x is damaged",), warnings=("w",), notes={"model": "m"})
    status = diagnostic_status("n", now, None, node)
    assert status.level == DiagnosticStatus.ERROR
    assert status.message == "model: x is damaged"
    assert values(status)["model"] == "m"
