# SPDX-License-Identifier: Apache-2.0
from collections import Counter
from itertools import count

from foretouch.ros.runtime.processing_node import StampSynchronizer


def make(depth=3):
    drops, clock = Counter(), count()
    receive, drop = lambda: float(next(clock)), lambda reason: drops.update([reason])
    return StampSynchronizer(frozenset({"cloud", "table"}), depth, receive, drop), drops


def test_a_set_is_complete_in_either_order_and_keeps_its_first_arrival():
    sets, drops = make()
    assert sets.add("cloud", 7, "c7") is None
    assert sets.add("table", 8, "t8") is None
    assert sets.add("table", 7, "t7") == ({"cloud": "c7", "table": "t7"}, 0.0)
    assert sets.add("cloud", 8, "c8").arrived == 1.0
    assert (dict(drops), len(sets._waiting)) == ({}, 0)
    sets.add("cloud", 1_000_000_000_000_000_000, "c")
    assert sets.add("table", 1_000_000_000_000_000_001, "t") is None  # a nanosecond apart


def test_the_oldest_incomplete_set_makes_room_and_every_dropped_one_is_counted():
    sets, drops = make(depth=3)
    for stamp in range(5):
        sets.add("cloud", stamp, stamp)
    assert drops == {"unpaired": 2}
    assert sets.add("table", 0, "late") is None
    assert sets.add("table", 4, "t").messages["cloud"] == 4
    waiting = len(sets._waiting)
    sets.clear("stopped")
    assert (drops["stopped"], len(sets._waiting)) == (waiting, 0)


def test_a_repeated_stamp_drops_the_first():
    sets, drops = make()
    sets.add("cloud", 1, "first")
    sets.add("cloud", 1, "second")
    assert drops == {"repeated_stamp": 1}
    assert sets.add("table", 1, "t").messages["cloud"] == "second"
