# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest
from std_msgs.msg import String

from foretouch.errors import MissingDependencyError
from foretouch.ros.messages.tactile import biotac_all_to_msg, tactile_class
from foretouch.tactile.messages.biotac_all import FINGER_ORDER, finger_counts
from foretouch.tactile.messages.table import stamp_ns

START = 1_763_000_000_000_000_000


def test_messages_hold_each_finger_at_its_index():
    counts = {name: np.arange(25, dtype=np.int16) + 100 * k for k, name in enumerate(("TH", "FF"))}
    sent = biotac_all_to_msg(counts, "hand", START)
    assert (sent.header.frame_id, stamp_ns(sent.header.stamp)) == ("hand", START)
    assert [list(one.electrodes[:2]) for one in sent.tactiles] == [[101, 102], [0, 0], [0, 0], [0, 0], [1, 2]]
    for name in FINGER_ORDER:
        np.testing.assert_array_equal(finger_counts(sent, name), counts.get(name, np.zeros(25)))
    assert {(one.tac, one.tdc) for one in sent.tactiles} == {(0, 0)}
    warm = biotac_all_to_msg({"TH": np.arange(29, dtype=np.int16)}, "hand", START).tactiles[-1]
    assert (len(warm.electrodes), warm.pac0, warm.pac1, warm.tac, warm.tdc) == (24, 25, 26, 27, 28)


def test_a_class_is_found_by_its_type_and_a_missing_package_is_named():
    assert tactile_class("std_msgs/String") is String
    with pytest.raises(MissingDependencyError, match="sr_robot_msgs is not installed"):
        tactile_class("sr_robot_msgs/BiotacAll")
