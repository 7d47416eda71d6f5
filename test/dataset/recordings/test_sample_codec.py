# SPDX-License-Identifier: Apache-2.0
"""A sample through its message and back, and what is refused."""

import hashlib
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from every_case import every_case
from recording_builders import IDENTITY, QUICK, assert_same_sample, record

from foretouch.dataset.identity import check_id
from foretouch.dataset.recordings.bag import Recording
from foretouch.dataset.recordings.reader import RecordedDataset
from foretouch.dataset.recordings.sample_codec import (
    SAMPLE_TYPE,
    Definitions,
    decode_sample,
    encode_sample,
    sample_types,
)
from foretouch.dataset.recordings.writer import RecordingWriter
from foretouch.errors import DatasetError
from foretouch.tactile import biotac_touch
from foretouch.types import Cloud, Sample, TouchSeries

REPOSITORY = Path(__file__).parents[3]


def with_sample(made: Sample, **changes: Any) -> Sample:
    return replace(made, **{"id": "ball/000001", **changes})


def test_every_field_comes_back_and_an_unlabelled_sample_has_no_touch() -> None:
    made = with_sample(record(3))
    stored = decode_sample(encode_sample(made, IDENTITY))
    back = stored.sample
    assert_same_sample(back, made)
    assert back.id == made.id
    assert back.grasp.id == "grasp-3"
    assert back.cloud.stamp_ns == made.cloud.stamp_ns
    assert back.cloud.frame_id == "camera"
    for name in ("outcome", "note", "contact_ns", "detector", "pairing_error_ns", "flags"):
        assert getattr(back, name) == getattr(made, name), name
    assert [grasp.id for grasp in back.candidates] == ["other-3"]
    assert stored.identity == IDENTITY
    for name in ("stamps_ns", "counts", "phases"):
        np.testing.assert_array_equal(getattr(back.series, name), getattr(made.series, name))
    np.testing.assert_equal(dict(back.series.others), made.series.others)
    # an unlabelled sample with an organised cloud
    xyz = np.full((4, 5, 3), np.nan, np.float32)
    xyz[1, 2] = [0.1, 0.2, 1.0]
    made = record(1, labelled=False)
    back = decode_sample(encode_sample(with_sample(made, cloud=Cloud(xyz)), IDENTITY)).sample
    np.testing.assert_array_equal(back.cloud.xyz, xyz)
    unset = (back.cloud.rgb, back.touch, back.tare, back.series, back.contact_ns)
    assert (*unset, back.pairing_error_ns) == (None,) * 6


def test_any_changed_byte_is_detected_and_other_bytes_are_refused_in_one_line() -> None:
    data = encode_sample(with_sample(record(0, points=5)), IDENTITY)
    for place in range(0, len(data), 97):
        changed = bytearray(data)
        changed[place] ^= 1
        with pytest.raises(DatasetError, match="SHA-256"):
            decode_sample(bytes(changed))
    for size in (0, 4, 31, 32, 40):
        body = b"\xff" * size
        with pytest.raises(DatasetError) as caught:
            decode_sample(body + hashlib.sha256(body).digest())
        assert "\n" not in str(caught.value)
    body = bytearray(data[:-32])
    place = 4 + 12 + len("camera") + 1
    place += place % 2
    assert body[place : place + 2] == b"\3\0"
    for version, rule in (
        (9, "9 is not 3: it was written by a newer foretouch"),
        (1, "1 is of foretouch 0.2: convert it"),
    ):
        body[place] = version
        with pytest.raises(DatasetError, match=f"schema_version: {rule}"):
            decode_sample(bytes(body) + hashlib.sha256(body).digest())


def test_what_cannot_be_recorded_is_refused() -> None:
    def check(sample_id: str, label: str) -> None:
        with pytest.raises(DatasetError) as caught:
            check_id(sample_id, label)
        assert "\n" not in str(caught.value)

    cases = [
        ("../000001", ".."), ("ball/../x", "ball"), ("ball/..", "ball"), ("ball", "ball"), ("/etc", ""),
        ("ball/a\nb", "ball"), ("other/1", "ball"), ("ball/" + 101 * "x", "ball"),
    ]  # fmt: skip
    every_case(cases, check)
    bad = biotac_touch(np.full(50, np.nan))
    for change, rule in (
        ({"touch": bad}, "ball/000001: touch: holds a value that is not finite"),
        ({"tare": bad}, "ball/000001: tare: holds a value that is not finite"),
        ({"stamp_ns": -1}, "stamp_ns: -1 is before 1970"),
        ({"stamp_ns": 2**31 * 10**9}, "is before 1970 or after 2038"),
    ):
        with pytest.raises(DatasetError, match=rule):
            encode_sample(with_sample(record(0), **change), IDENTITY)
    with pytest.raises(DatasetError, match=r"series.phases: shape \(2,\) is not \(3,\)"):
        TouchSeries(np.zeros(3, np.int64), np.zeros((3, 50), np.float32), np.zeros(2, np.uint8))


def fields(path: Path) -> list[str]:
    return re.findall(r"^[\w/]+(?:\[\d*\])? +\w+", path.read_text(encoding="utf-8"), re.MULTILINE)


def test_stored_samples_have_the_first_fields_of_the_messages_and_all_types_in_them() -> None:
    for name in ("GraspSample", "StoredGrasp"):
        ours = fields(REPOSITORY / "src/foretouch/dataset/recordings/definitions" / f"{name}.msg")
        theirs = fields(REPOSITORY / "foretouch_msgs/msg" / f"{name}.msg")
        assert ours == theirs[: len(ours)]  # what is added to a message later is not stored
    text = sample_types().text(SAMPLE_TYPE)
    types = (
        "sensor_msgs/PointField",
        "foretouch_msgs/StoredGrasp",
        "geometry_msgs/Quaternion",
        "builtin_interfaces/Time",
    )
    assert all(f"MSG: {name}" in text for name in types)
    with pytest.raises(DatasetError, match="nowhere_msgs/msg/Thing: no definition is known, and nowhere_msgs is not"):
        Definitions().text("nowhere_msgs/msg/Thing")
    with pytest.raises(DatasetError, match="is not a message type"):
        Definitions().text("../../etc/passwd")


@pytest.mark.ros
def test_a_topic_is_recorded_with_the_definition_of_its_installed_messages(tmp_path: Path) -> None:
    messages = pytest.importorskip("foretouch_msgs.msg", reason="the messages are not built")
    from rclpy.serialization import serialize_message

    grasps = [
        messages.Grasp(id=name, hand="franka_hand", depth_m=0.5, joints=["finger"], posture=[0.04])
        for name in ("a", "b")
    ]
    with RecordingWriter(tmp_path / "ds", IDENTITY, QUICK) as writer:
        writer.add_topic("/foretouch/grasps", "foretouch_msgs/msg/GraspArray")
        writer.receive("/foretouch/grasps")
        writer.write("/foretouch/grasps", serialize_message(messages.GraspArray(grasps=grasps, reason="r")), 1)
        writer.append(record(0))
    with Recording(writer.file) as bag:
        (content,) = [bag.content(message) for message in bag.messages(["/foretouch/grasps"])]
    found = [(grasp.id, grasp.hand, grasp.depth_m, grasp.joints) for grasp in content.grasps]
    assert (found, content.reason) == (
        [("a", "franka_hand", 0.5, ["finger"]), ("b", "franka_hand", 0.5, ["finger"])],
        "r",
    )
    assert len(RecordedDataset(tmp_path / "ds")) == 1
