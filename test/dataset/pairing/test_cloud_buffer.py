# SPDX-License-Identifier: Apache-2.0
"""Clouds are bounded in time and in memory, and never mixed up."""

from __future__ import annotations

from foretouch.dataset.pairing import CloudBuffer


def test_the_oldest_go_when_their_time_is_over() -> None:
    clouds = CloudBuffer(kept_s=10.0, kept_mb=1.0)
    assert clouds.add(1, b"a", 0.0) == []
    assert clouds.add(2, b"b", 9.0) == []
    assert [gone.stamp_ns for gone in clouds.add(3, b"c", 10.5)] == [1]
    assert clouds.get(1) is None
    assert clouds.get(2).data == b"b"


def test_the_oldest_go_when_memory_is_short() -> None:
    clouds = CloudBuffer(kept_s=1e6, kept_mb=1.0)
    gone = [one.stamp_ns for k in range(10) for one in clouds.add(k, bytes(300_000), 0.0)]
    assert gone == list(range(7))
    assert (len(clouds), clouds.bytes) == (3, 900_000)
    assert [one.stamp_ns for one in clouds.clear()] == [7, 8, 9]
    assert (len(clouds), clouds.bytes) == (0, 0)


def test_the_same_message_twice_is_one_cloud_and_two_of_one_stamp_are_neither() -> None:
    clouds = CloudBuffer(10.0, 1.0)
    clouds.add(1, b"a", 0.0)
    clouds.add(1, b"a", 0.1)
    assert not clouds.get(1).ambiguous
    clouds.add(1, b"b", 0.2)
    assert clouds.get(1).ambiguous
    assert clouds.bytes == 1
