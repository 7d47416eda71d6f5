# SPDX-License-Identifier: Apache-2.0
"""How `benchmarks/soak` explains what became of a cloud."""

from benchmarks.soak import accounting

ALL = {1, 2, 3, 4, 5}
CLOUDS = {number: 10.0 * number for number in ALL}


def outputs(**missing: int) -> dict[str, set[int]]:
    """Stamps by topic; from the missing one on, the chain gives nothing for that cloud."""
    topics = ("object_cloud", "table", "grasps", "touch")
    return {topic: ALL - {missing.get(name, 0) for name in topics[: topics.index(topic) + 1]} for topic in topics}


def test_each_cloud_is_explained_by_an_outage_or_a_drop_of_the_node_that_lost_it() -> None:
    def account(clouds, topics, outages=(), drops=()):
        fates, unexplained = accounting.account(clouds, topics, outages, drops)
        return dict(fates), unexplained

    assert account(CLOUDS, outputs(grasps=3)) == ({"answered": 4, "unexplained at grasp": 1}, [(3, "grasp")])
    outage = accounting.Outage("grasp", "killed", 29.0, 35.0)
    assert account(CLOUDS, outputs(grasps=3), [outage])[0] == {"answered": 4, "dropped by grasp: killed": 1}
    assert account(CLOUDS, outputs(grasps=4), [outage])[1] == [(4, "grasp")]
    killed = accounting.Outage("segmentation", "killed", 29.0, 35.0)  # what it sent last has reached the observer alone
    assert account(CLOUDS, outputs(grasps=3), [killed])[0] == {
        "answered": 4,
        "dropped by grasp: segmentation killed": 1,
    }
    camera = accounting.Outage("camera", "killed", 29.0, 35.0)
    assert account(CLOUDS, outputs(touch=3), [camera])[1] == [(3, "touch_predictor")]
    drop = accounting.Drop("segmentation", "superseded", 1, 20.0, 21.0)  # each counted drop explains one cloud
    fates, unexplained = account({1: 20.1, 2: 20.2}, {topic: set() for topic in outputs()}, [], [drop])
    assert fates == {"dropped by segmentation: superseded": 1, "unexplained at segmentation": 1}
    assert unexplained == [(2, "segmentation")]
