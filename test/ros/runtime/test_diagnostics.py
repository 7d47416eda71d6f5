# SPDX-License-Identifier: Apache-2.0
"""Counts of inputs, the report of a node, and messages that reach no callback, whoever lost them."""

from types import SimpleNamespace

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus

from foretouch.ros.runtime.diagnostics import InputStatistics, Report

pytestmark = pytest.mark.ros


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


def test_the_rate_falls_to_nothing_ten_seconds_after_the_last_input(monkeypatch):
    clock = [100.0]
    monkeypatch.setattr("foretouch.ros.runtime.diagnostics.time", SimpleNamespace(monotonic=lambda: clock[0]))
    statistics = InputStatistics()
    for _ in range(1000):
        statistics.use(statistics.receive(), 0.0)
        clock[0] += 1 / 30
    rates = []
    for _ in range(3):
        rates.append(statistics.summary().rate_hz)
        clock[0] += 5.0
    assert rates == [pytest.approx(30.0, abs=0.2), pytest.approx(15.0, abs=0.2), 0.0]


def report_of(statistics, silence_s=None):
    report = Report()
    statistics.add_to(report, silence_s)
    return report


def test_silence_is_a_warning_where_inputs_are_expected_drops_are_reported_once_and_an_error_outweighs_both():
    statistics = InputStatistics()
    silent = report_of(statistics, 5.0)
    assert silent.warnings == ["no input yet"]
    assert report_of(statistics).warnings == []
    status = silent.to_msg("n", "fine")
    assert (status.level, status.message) == (DiagnosticStatus.WARN, "no input yet")
    silent.errors.append("model: x is damaged")
    silent.values["model"] = "m"
    status = silent.to_msg("n", "fine")
    assert (status.level, status.message) == (DiagnosticStatus.ERROR, "model: x is damaged")
    assert {pair.key: pair.value for pair in status.values}["model"] == "m"
    statistics.receive()
    statistics.drop("superseded")
    statistics.lose(3)
    report = report_of(statistics, 5.0)
    assert report.warnings == ["dropped since the last report: 1 superseded, 3 lost in transport"]
    assert (report.values["dropped.superseded"], report.values["lost_on_the_way"]) == ("1", "3")
    status = report_of(statistics).to_msg("n", "fine")
    assert (status.level, status.message) == (DiagnosticStatus.OK, "fine")
