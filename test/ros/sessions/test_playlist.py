# SPDX-License-Identifier: Apache-2.0
"""Sources as timed messages."""

import numpy as np
from rosbags.typesys import Stores, get_typestore

from foretouch.cloud.io.files import write_cloud
from foretouch.dataset.formats.rosbag2 import BagWriter, write_bag
from foretouch.dataset.recordings.bag import POINT_CLOUD_TYPE
from foretouch.dataset.recordings.sample_codec import serialize_cloud
from foretouch.dataset.source import STAMP_STEP_NS, open_source
from foretouch.ros.sessions.playlist import CLOUDS, Entry, Pace, cloud_is_object, entries
from foretouch.types import Cloud

STORE = get_typestore(Stores.ROS2_KILTED)
STRING = "std_msgs/msg/String"


def cloud_of(number: float, stamp_ns: int = 0, shape: tuple[int, ...] = (5,)) -> Cloud:
    return Cloud(np.full((*shape, 3), number, np.float32), None, "camera", stamp_ns)


def said(text: str) -> bytes:
    return bytes(STORE.serialize_cdr(STORE.types[STRING](text), STRING))


def test_a_message_that_is_no_cdr_is_refused_and_one_with_wrong_sizes_is_played(tmp_path):
    content = STORE.deserialize_cdr(serialize_cloud(cloud_of(1, 10)), POINT_CLOUD_TYPE)
    content.width += 1
    data = bytes(STORE.serialize_cdr(content, POINT_CLOUD_TYPE))
    with BagWriter(tmp_path / "bag") as writer:
        writer.write("/points", POINT_CLOUD_TYPE, 10, data)
        writer.write("/points", POINT_CLOUD_TYPE, 15, b"\0\1\0\0broken")
        writer.write_cloud(cloud_of(2, 20), "/points")
    first, second, third = entries(open_source(tmp_path / "bag"))
    assert (first.refusal, first.data) == ("", data)
    assert "/points[1]: truncated or damaged" in second.refusal
    assert third.refusal == ""


def test_files_that_are_no_image_hold_an_object_and_recordings_what_a_camera_delivers(tmp_path):
    for name, shape in (("images", (4, 6)), ("objects", (24,))):
        (tmp_path / name).mkdir()
        (tmp_path / name / "0.npz").write_bytes(b"unreadable: the next one decides")
        write_cloud(tmp_path / name / "1.npz", cloud_of(1, shape=shape))
        assert cloud_is_object(open_source(tmp_path / name)) is (name == "objects")
    write_bag(tmp_path / "bag", [cloud_of(1)])
    assert not cloud_is_object(open_source(tmp_path / "bag"))
    (tmp_path / "images" / "1.npz").write_bytes(b"unreadable too")
    assert not cloud_is_object(open_source(tmp_path / "images"))


def test_recorded_times_are_kept_or_a_rate_paces_the_clouds():
    def due(*times: tuple[str, int]) -> list[float]:
        return [pace.due_s(Entry("", topic, at_ns, b"")) for topic, at_ns in times]

    pace = Pace()
    assert due((CLOUDS, 5_000_000_000), (CLOUDS, 5_500_000_000), (CLOUDS, 6_000_000_000)) == [0.0, 0.5, 1.0]
    assert (pace.length_ns, pace.length_s) == (1_500_000_000, 1.5)
    pace = Pace(rate_hz=4.0)  # the others follow the cloud before them
    assert due(("/a", 0), (CLOUDS, 1), ("/a", 2), (CLOUDS, 9), ("/a", 9)) == [0.0, 0.0, 0.0, 0.25, 0.25]
    assert pace.length_s == 0.5
    pace = Pace()
    due((CLOUDS, 7))
    assert pace.length_ns == STAMP_STEP_NS  # of a single cloud


def test_a_pause_where_a_clock_was_set_is_cut_and_told():
    pace = Pace(longest_pause_s=2.0)
    now_ns = 1_700_000_000_000_000_000
    times = (5_000_000_000, 6_500_000_000, now_ns, now_ns + 500_000_000, 2**64 - 1)
    due, cuts = [], []
    for at_ns in times:
        due.append(round(pace.due_s(Entry("", CLOUDS, at_ns, b"")), 3))
        cuts.append(round(pace.cut_s))
    assert due == [0.0, 1.5, 3.5, 4.0, 6.0]
    assert cuts == [0, 0, 1_699_999_992, 0, 16_746_744_071]
    assert round(pace.length_s, 3) == 7.5  # with a mean period after the last
    assert pace.length_ns > 2**64 - 1 - 5_000_000_000
    paced = Pace(rate_hz=2.0)
    assert [paced.due_s(Entry("", CLOUDS, at_ns, b"")) for at_ns in times[:3]] == [0.0, 0.5, 1.0]
    assert paced.cut_s == 0.0
