# SPDX-License-Identifier: Apache-2.0
"""How `benchmarks/soak` explains what became of a cloud."""

import pytest

from benchmarks.soak import accounting

ALL = {1, 2, 3, 4, 5}
CLOUDS = {number: 10.0 * number for number in ALL}


def outputs(**missing: int) -> dict[str, set[int]]:
    """Stamps by topic; from the missing one on, the chain gives nothing for that cloud."""
    topics = ("object_cloud", "table", "grasps", "touch")
    return {topic: ALL - {missing.get(name, 0) for name in topics[: topics.index(topic) + 1]} for topic in topics}


def test_a_cloud_without_a_reason_is_unexplained_where_it_was_lost() -> None:
    fates, unexplained = accounting.account(CLOUDS, outputs(grasps=3), [], [])
    assert fates == {"answered": 4, "unexplained at grasp": 1}
    assert unexplained == [(3, "grasp")]


def test_an_outage_explains_the_clouds_of_its_time_and_node() -> None:
    outage = accounting.Outage("grasp", "killed", 29.0, 35.0)
    assert accounting.account(CLOUDS, outputs(grasps=3), [outage], [])[0]["dropped by grasp: killed"] == 1
    assert accounting.account(CLOUDS, outputs(grasps=4), [outage], [])[1] == [(4, "grasp")]
    assert accounting.account(CLOUDS, outputs(touch=3), [outage], [])[1] == [(3, "touch_predictor")]


def test_each_counted_drop_explains_one_cloud() -> None:
    drop = accounting.Drop("segmentation", "superseded", 1, 20.0, 21.0)
    fates, unexplained = accounting.account({1: 20.1, 2: 20.2}, {topic: set() for topic in outputs()}, [], [drop])
    assert fates == {"dropped by segmentation: superseded": 1, "unexplained at segmentation": 1}
    assert unexplained == [(2, "segmentation")]


def test_the_slope_is_per_hour() -> None:
    assert accounting.slope_per_hour([0.0, 1800.0, 3600.0], [100.0, 101.0, 102.0]) == pytest.approx(2.0)
