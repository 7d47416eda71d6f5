# SPDX-License-Identifier: Apache-2.0
"""Headers in serialised messages, against the serialiser of rosbags."""

import pytest
from every_case import every_case
from rosbags.typesys import Stores, get_typestore

from foretouch.cloud.messages import read_header, with_stamp
from foretouch.errors import DatasetError

STORE = get_typestore(Stores.ROS2_KILTED)
TYPE = "geometry_msgs/msg/PointStamped"


def serialised(stamp_ns: int, frame_id: str, *, little_endian: bool = True) -> bytes:
    types = STORE.types
    stamp = types["builtin_interfaces/msg/Time"](*divmod(stamp_ns, 10**9))
    point = types["geometry_msgs/msg/Point"](1.0, 2.0, 3.0)
    message = types[TYPE](types["std_msgs/msg/Header"](stamp, frame_id), point)
    return bytes(STORE.serialize_cdr(message, TYPE, little_endian=little_endian))


def test_headers_are_read_and_stamps_replaced_in_either_byte_order() -> None:
    def check(frame_id: str, little_endian: bool) -> None:
        stamp_ns = 1_700_000_000_999_999_999
        old = serialised(stamp_ns, frame_id, little_endian=little_endian)
        assert read_header(old) == (stamp_ns, frame_id)
        assert with_stamp(old, 7_000_000_008) == serialised(7_000_000_008, frame_id, little_endian=little_endian)

    every_case([(frame, little) for frame in ("", "camera", "ünïcode") for little in (True, False)], check)


def test_bytes_that_end_too_early_and_stamps_that_ros_cannot_hold_are_refused() -> None:
    for size in (0, 3, 4, 10, 15, 18):
        with pytest.raises(DatasetError, match="header: "):
            read_header(serialised(1, "camera")[:size])
    with pytest.raises(DatasetError, match="stamp 3000000000000000000 ns"):
        with_stamp(serialised(1, "camera"), 3 * 10**18)
