# SPDX-License-Identifier: Apache-2.0
"""How `benchmarks/soak` explains what became of a cloud."""

from benchmarks.soak import accounting

ALL = {1, 2, 3, 4, 5}
CLOUDS = {number: 10.0 * number for number in ALL}


def test_each_cloud_is_explained_by_an_outage_or_a_drop_of_the_node_that_lost_it() -> None:
    def account(clouds, answered, outages=(), drops=()):
        fates, unexplained = accounting.account(clouds, {"touch": answered}, outages, drops)
        return dict(fates), unexplained

    assert account(CLOUDS, ALL) == ({"answered": 5}, [])
    assert account(CLOUDS, ALL - {3}) == ({"answered": 4, "unexplained at perception": 1}, [(3, "perception")])
    outage = accounting.Outage("perception", "killed", 29.0, 35.0)
    assert account(CLOUDS, ALL - {3}, [outage])[0] == {"answered": 4, "dropped by perception: killed": 1}
    assert account(CLOUDS, ALL - {4}, [outage])[1] == [(4, "perception")]
    camera = accounting.Outage("camera", "killed", 29.0, 35.0)  # what it sent last has reached the observer alone
    assert account(CLOUDS, ALL - {3}, [camera])[0] == {"answered": 4, "dropped by perception: camera killed": 1}
    hand = accounting.Outage("hand", "killed", 29.0, 35.0)
    assert account(CLOUDS, ALL - {3}, [hand])[1] == [(3, "perception")]
    drop = accounting.Drop("perception", "superseded", 1, 20.0, 21.0)  # each counted drop explains one cloud
    fates, unexplained = account({1: 20.1, 2: 20.2}, set(), [], [drop])
    assert fates == {"dropped by perception: superseded": 1, "unexplained at perception": 1}
    assert unexplained == [(2, "perception")]
