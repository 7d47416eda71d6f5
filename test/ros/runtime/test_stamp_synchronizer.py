# SPDX-License-Identifier: Apache-2.0
from collections import Counter

from foretouch.ros.runtime.processing_node import StampSynchronizer


def make(depth=3):
    drops = Counter()
    clock = iter(range(1000))
    pairing = StampSynchronizer(
        ["cloud", "table"], depth, lambda: float(next(clock)), lambda reason: drops.update([reason])
    )
    return pairing, drops


def test_a_set_is_complete_in_either_order_and_keeps_its_first_arrival():
    pairing, drops = make()
    assert pairing.add("cloud", 7, "c7") is None
    assert pairing.add("table", 8, "t8") is None
    found = pairing.add("table", 7, "t7")
    assert found.messages == {"cloud": "c7", "table": "t7"}
    assert found.arrived == 0.0
    assert pairing.add("cloud", 8, "c8").arrived == 1.0
    assert not drops
    assert len(pairing) == 0


def test_stamps_that_differ_by_one_nanosecond_are_not_paired():
    pairing, _ = make()
    pairing.add("cloud", 1_000_000_000_000_000_000, "c")
    assert pairing.add("table", 1_000_000_000_000_000_001, "t") is None


def test_the_oldest_incomplete_set_makes_room_and_is_counted():
    pairing, drops = make(depth=3)
    for stamp in range(5):
        pairing.add("cloud", stamp, stamp)
    assert drops == {"unpaired": 2}
    assert pairing.add("table", 0, "late") is None
    assert pairing.add("table", 4, "t").messages["cloud"] == 4


def test_a_repeated_stamp_gives_up_the_first():
    pairing, drops = make()
    pairing.add("cloud", 1, "first")
    pairing.add("cloud", 1, "second")
    assert drops == {"repeated_stamp": 1}
    assert pairing.add("table", 1, "t").messages["cloud"] == "second"


def test_clear_counts_every_set():
    pairing, drops = make()
    pairing.add("cloud", 1, "a")
    pairing.add("table", 2, "b")
    pairing.clear("stopped")
    assert drops == {"stopped": 2}
    assert len(pairing) == 0
