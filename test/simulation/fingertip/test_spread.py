# SPDX-License-Identifier: Apache-2.0
"""Counts of simulated rigid grasps spread as those of real ones do (the benchmark's figures, on fewer grasps)."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[3] / "benchmarks" / "contact"))
from spread import grasps, spread

from foretouch.simulation.fingertip import MIDDLE_FINGER, THUMB, FingertipConfig


@pytest.mark.parametrize(
    ("kind", "median", "percentile_99"), [(MIDDLE_FINGER, 72.0, 691.0), (THUMB, 117.0, 986.0)], ids=["MF", "TH"]
)
def test_counts_spread_as_in_real_grasps(kind, median, percentile_99):
    found = spread(*grasps(kind, 200, 7, FingertipConfig()))
    assert median / 1.5 < found["drop_median"] < median * 1.5
    assert percentile_99 / 1.5 < found["drop_99"] < percentile_99 * 1.5
    assert 0.65 < found["share_of_4"] < 0.85
    assert abs(found["corr_pdc_mean_e"]) < 0.4
