# SPDX-License-Identifier: Apache-2.0
"""What `open_source` takes a path for, and what comes out in which order."""

import numpy as np
import pytest

from foretouch.cloud.io.files import write_cloud
from foretouch.dataset.formats.rosbag2 import write_bag
from foretouch.dataset.source import STAMP_STEP_NS, open_source
from foretouch.errors import FileError
from foretouch.types import Cloud


def cloud_of(number: float, size: int = 5, **fields) -> Cloud:
    return Cloud(np.full((size, 3), number, np.float32), **fields)


def test_a_folder_is_played_in_natural_order_with_rising_stamps(tmp_path):
    for number in (10, 9, 1, 2):
        write_cloud(tmp_path / f"frame{number}.npz", cloud_of(number))
    (tmp_path / "notes.txt").write_text("no cloud")
    source = open_source(tmp_path, frame_id="camera")
    clouds = [item.cloud for item in source]
    assert [item.name for item in source] == [item.name for item in source]  # as often as needed
    assert [c.xyz[0, 0] for c in clouds] == [1, 2, 9, 10]
    assert [c.stamp_ns for c in clouds] == [STAMP_STEP_NS * k for k in (1, 2, 3, 4)]
    assert {c.frame_id for c in clouds} == {"camera"}


def test_a_recording_keeps_frames_and_stamps_and_another_count_in_its_metadata_is_told(tmp_path):
    clouds = [cloud_of(k, frame_id="lidar", stamp_ns=100 + k) for k in range(3)]
    write_bag(tmp_path / "bag", clouds)
    source = open_source(tmp_path / "bag", frame_id="unused")
    assert (source.kind, source.topic, len(source)) == ("recording", "/foretouch/points", 3)
    assert [(i.cloud.frame_id, i.cloud.stamp_ns) for i in source] == [("lidar", 100), ("lidar", 101), ("lidar", 102)]
    assert [i.name for i in source][2] == f"{tmp_path / 'bag'}[2]"
    metadata = tmp_path / "bag" / "metadata.yaml"
    metadata.write_text(metadata.read_text().replace("message_count: 3", "message_count: 4"))
    changed = open_source(tmp_path / "bag")
    assert len(list(changed)) == 3
    assert changed.notes == (f"{metadata}: /foretouch/points: states 4 messages, the files hold 3",)


def test_what_is_nothing_known(tmp_path):
    (tmp_path / "notes.txt").write_text("x")
    (tmp_path / "empty").mkdir()
    write_cloud(tmp_path / "1.npz", cloud_of(1))
    for name, topic, rule in (
        (
            "notes.txt",
            None,
            "notes.txt: the extension is not one of .pcd, .ply, .npz, .npy, .png, .tif, .tiff, .mcap, .db3, .bag",
        ),
        ("empty", None, "holds no clouds"),
        ("absent", None, "absent: does not exist"),
        ("1.npz", "/points", "is not a recording, so it has no topic /points"),
    ):
        with pytest.raises(FileError, match=rule):
            open_source(tmp_path / name, topic)
