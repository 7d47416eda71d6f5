# SPDX-License-Identifier: Apache-2.0
"""Counts of inputs, the report of a node, and messages that reach no callback, whoever lost them."""

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus

from foretouch.ros.runtime.diagnostics import InputStatistics, diagnostic_status

pytestmark = pytest.mark.ros


def values(status):
    return {pair.key: pair.value for pair in status.values}


def test_every_input_is_accounted_for_with_the_quantiles_of_numpy_and_none_before_the_first():
    statistics = InputStatistics()
    now = statistics.summary()
    assert (now.latency_ms, now.idle_s, now.rate_hz) == (None, None, 0.0)
    ages = np.arange(1, 101) / 1000.0
    for arrived, age in zip([statistics.receive() for _ in range(104)], ages.tolist(), strict=False):
        statistics.use(arrived, age)
    for reason in ("superseded", "superseded", "inactive"):
        statistics.drop(reason)
    now = statistics.summary()
    assert (now.received, now.used, now.waiting) == (104, 100, 1)
    assert now.dropped == {"superseded": 2, "inactive": 1}
    np.testing.assert_allclose(now.input_age_ms, np.percentile(ages * 1e3, [50, 95]))


def test_silence_is_a_warning_where_inputs_are_expected_drops_are_reported_once_and_an_error_outweighs_both():
    statistics = InputStatistics()
    before = statistics.summary()
    silent = diagnostic_status("n", "active", before, silence_s=5.0)
    assert (silent.level, silent.message) == (DiagnosticStatus.WARN, "no input yet")
    for status in (diagnostic_status("n", "active", before), diagnostic_status("n", "inactive", before, silence_s=5.0)):
        assert status.level == DiagnosticStatus.OK
    found = {"errors": ("model: x is damaged",), "warnings": ("w",), "notes": {"model": "m"}}
    status = diagnostic_status("n", "active", before, **found)
    assert (status.level, status.message) == (DiagnosticStatus.ERROR, "model: x is damaged")
    assert values(status)["model"] == "m"
    statistics.receive()
    statistics.drop("superseded")
    statistics.lose(3)
    now = statistics.summary()
    status = diagnostic_status("n", "active", now, before)
    assert status.message == "dropped: 1 superseded, 3 lost in transport"
    assert (values(status)["dropped.superseded"], values(status)["lost_on_the_way"]) == ("1", "3")
    assert diagnostic_status("n", "active", now, now).level == DiagnosticStatus.OK
