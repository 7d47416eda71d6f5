# SPDX-License-Identifier: Apache-2.0
import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus

from foretouch.ros.runtime.diagnostics import InputStatistics, diagnostic_status


def values(status):
    return {pair.key: pair.value for pair in status.values}


def test_every_input_is_accounted_for():
    statistics = InputStatistics()
    for arrived in [statistics.receive() for _ in range(10)][:6]:
        statistics.use(arrived, 0.1)
    for reason in ("superseded", "superseded", "inactive"):
        statistics.drop(reason)
    now = statistics.summary()
    assert (now.received, now.used, now.waiting) == (10, 6, 1)
    assert now.dropped == {"superseded": 2, "inactive": 1}


def test_quantiles_are_those_of_numpy_and_none_is_made_up_before_the_first_input():
    statistics = InputStatistics()
    now = statistics.summary()
    assert (now.latency_ms, now.idle_s, now.rate_hz) == (None, None, 0.0)
    ages = np.arange(1, 101) / 1000.0
    for age in ages:
        statistics.use(statistics.receive(), float(age))
    np.testing.assert_allclose(statistics.summary().input_age_ms, np.percentile(ages * 1e3, [50, 95]))


def test_silence_is_a_warning_only_where_inputs_are_expected_and_the_node_is_active():
    now = InputStatistics().summary()
    silent = diagnostic_status("n", "active", now, silence_s=5.0)
    assert (silent.level, silent.message) == (DiagnosticStatus.WARN, "no input yet")
    for status in (diagnostic_status("n", "active", now), diagnostic_status("n", "inactive", now, silence_s=5.0)):
        assert status.level == DiagnosticStatus.OK


def test_drops_are_reported_once_with_their_reasons():
    statistics = InputStatistics()
    before = statistics.summary()
    statistics.receive()
    statistics.drop("superseded")
    statistics.lose(3)
    now = statistics.summary()
    status = diagnostic_status("n", "active", now, before)
    assert status.message == "dropped: 1 superseded, 3 lost in transport"
    assert (values(status)["dropped.superseded"], values(status)["lost_on_the_way"]) == ("1", "3")
    assert diagnostic_status("n", "active", now, now).level == DiagnosticStatus.OK


def test_an_error_outweighs_warnings():
    found = {"errors": ("model: x is damaged",), "warnings": ("w",), "notes": {"model": "m"}}
    status = diagnostic_status("n", "active", InputStatistics().summary(), **found)
    assert (status.level, status.message) == (DiagnosticStatus.ERROR, "model: x is damaged")
    assert values(status)["model"] == "m"
