# SPDX-License-Identifier: Apache-2.0
"""Recordings in all containers, and what becomes of damaged ones."""

import os
import re
from pathlib import Path

import numpy as np
import pytest
from bag_builders import make_clouds, read_bag
from every_case import every_case, every_refusal
from mcap.reader import make_reader
from mcap.writer import Writer as McapWriter
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.rosbag2.enums import CompressionFormat, CompressionMode
from rosbags.typesys import Stores, get_typestore

from foretouch.dataset.formats.rosbag2 import BagWriter, write_bag
from foretouch.dataset.recordings.bag import POINT_CLOUD_TYPE, Recording, is_recording
from foretouch.errors import DatasetError, FileError
from foretouch.types import Cloud

TOPIC = "/foretouch/points"
KILTED = get_typestore(Stores.ROS2_KILTED)
NOETIC = get_typestore(Stores.ROS1_NOETIC)


def assert_same(read: Cloud, written: Cloud) -> None:
    np.testing.assert_array_equal(read.xyz, written.xyz)
    np.testing.assert_array_equal(read.rgb, written.rgb)
    assert (read.frame_id, read.stamp_ns) == (written.frame_id, written.stamp_ns)


def foreign_message(store, xyz: np.ndarray, *, stamp_ns: int, seq: int | None = None, **changes):
    """A PointCloud2 as others write it: big-endian, z y x, bytes between the fields, the points and the rows."""
    height, width, _ = xyz.shape
    point_step, row_step = 20, 20 * width + 12
    layout = np.dtype({"names": ["z", "y", "x"], "formats": [">f4"] * 3, "offsets": [0, 8, 12], "itemsize": point_step})
    points = np.full((height, width * point_step), 0xAB, np.uint8)
    for axis, name in enumerate("xyz"):
        points.view(layout)[name] = xyz[..., axis]
    rows = np.pad(points, ((0, 0), (0, row_step - points.shape[1])), constant_values=0xAB)
    types = store.types
    stamp = types["builtin_interfaces/msg/Time"](*divmod(stamp_ns, 10**9))
    header = {"stamp": stamp, "frame_id": "lidar"} | ({} if seq is None else {"seq": seq})
    content = {
        "header": types["std_msgs/msg/Header"](**header),
        "height": height,
        "width": width,
        "fields": [types["sensor_msgs/msg/PointField"](n, o, 7, 1) for n, o in (("z", 0), ("y", 8), ("x", 12))],
        "is_bigendian": True,
        "point_step": point_step,
        "row_step": row_step,
        "data": rows.reshape(-1),
        "is_dense": True,
    }
    return types[POINT_CLOUD_TYPE](**(content | changes))


def write_foreign(
    path: Path, messages: list, plugin: StoragePlugin = StoragePlugin.SQLITE3, mode: CompressionMode | None = None
) -> None:
    writer = Writer(path, version=8, storage_plugin=plugin)
    if mode is not None:
        writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        connection = writer.add_connection("/cloud", POINT_CLOUD_TYPE, typestore=KILTED)
        for number, message in enumerate(messages):
            writer.write(connection, 10 + number, KILTED.serialize_cdr(message, POINT_CLOUD_TYPE))


def test_what_is_written_is_read_also_by_the_mcap_library(tmp_path, rng):
    def check(name: str, clouds: list[Cloud]) -> None:
        assert write_bag(tmp_path / name, clouds) == len(clouds)
        read = list(read_bag(tmp_path / name))
        assert len(read) == len(clouds)
        for one, other in zip(read, clouds, strict=True):
            assert_same(one, other)

    cases = [
        ("images", make_clouds(rng)),
        ("objects", make_clouds(rng, shape=(40,))),
        ("empty", [Cloud(np.empty((0, 3), np.float32), stamp_ns=5)]),
        ("many chunks", make_clouds(rng, count=9, shape=(150, 200))),  # 480 kB each, chunks close at 1 MiB
    ]
    every_case(cases, check)
    (tmp_path / "images" / "metadata.yaml").unlink()
    for path in (tmp_path / "images", tmp_path / "images" / "images.mcap"):  # without metadata, and a bare file
        assert_same(next(read_bag(path)), cases[0][1][0])
    clouds = make_clouds(rng)
    write_bag(tmp_path / "bag", clouds)
    with (tmp_path / "bag" / "bag.mcap").open("rb") as stream:
        found = [(channel.topic, message) for _, channel, message in make_reader(stream, True).iter_messages()]
    for (topic, message), cloud in zip(found, clouds, strict=True):
        assert (topic, message.log_time) == (TOPIC, cloud.stamp_ns)
        content = KILTED.deserialize_cdr(message.data, POINT_CLOUD_TYPE)
        np.testing.assert_array_equal(content.data.view("<f4").reshape(12, 16, 4)[..., :3], cloud.xyz)


def test_bags_of_others_with_an_odd_layout_any_compression_or_of_ros1(tmp_path, rng):
    xyz = rng.normal(size=(3, 5, 3)).astype(np.float32)

    def check(plugin: StoragePlugin, mode: CompressionMode | None) -> None:
        path = tmp_path / f"{plugin.name}{mode and mode.name}"
        write_foreign(path, [foreign_message(KILTED, xyz, stamp_ns=3_000_000_004)], plugin, mode)
        (cloud,) = read_bag(path)
        np.testing.assert_array_equal(cloud.xyz, xyz)
        assert (cloud.frame_id, cloud.stamp_ns) == ("lidar", 3_000_000_004)

    modes = (None, CompressionMode.FILE, CompressionMode.MESSAGE)
    every_case([(plugin, mode) for plugin in StoragePlugin for mode in modes], check)
    with Ros1Writer(tmp_path / "old.bag") as writer:
        connection = writer.add_connection("/cloud", POINT_CLOUD_TYPE, typestore=NOETIC)
        for seq in range(3):
            message = foreign_message(NOETIC, xyz + seq, stamp_ns=seq, seq=seq)
            writer.write(connection, 10 + seq, NOETIC.serialize_ros1(message, POINT_CLOUD_TYPE))
    clouds = list(read_bag(tmp_path / "old.bag"))
    assert [c.stamp_ns for c in clouds] == [0, 1, 2]
    np.testing.assert_array_equal(clouds[2].xyz, xyz + np.float32(2))
    with Recording(tmp_path / "old.bag") as recording:
        message = next(recording.messages())
        content = KILTED.deserialize_cdr(message.data, message.type)  # without the seq of ROS 1
    assert content.header.frame_id == "lidar"


def test_topics_are_listed_and_one_that_is_absent_empty_ambiguous_or_of_another_type_is_named(tmp_path, rng):
    first, second = make_clouds(rng, count=2)
    with BagWriter(tmp_path / "bag") as writer:
        writer.definitions.register("my_msgs/msg/Reading", "std_msgs/Header header\nint16[] electrodes\n")
        writer.write("/tactile", "my_msgs/msg/Reading", 0, b"\0\1\0\0")
        writer.write_cloud(first, "/left")
        writer.write_cloud(second, "/right")
        writer.add_topic("/never_used", POINT_CLOUD_TYPE)
    with Recording(tmp_path / "bag") as recording:
        left, _, _, tactile = recording.topics
    assert (left.name, left.type, left.count) == ("/left", POINT_CLOUD_TYPE, 1)
    assert (tactile.type, tactile.count, tactile.fields) == ("my_msgs/msg/Reading", 1, ("header", "electrodes"))
    assert_same(*read_bag(tmp_path / "bag", "/right"), second)
    with BagWriter(tmp_path / "said") as writer:
        writer.add_topic("/said", "std_msgs/msg/String")
        with pytest.raises(DatasetError, match="/said: holds std_msgs/msg/String, not std_msgs/msg/Bool"):
            writer.add_topic("/said", "std_msgs/msg/Bool")
        with pytest.raises(DatasetError, match="nobodys_msgs/msg/X: no definition is known"):
            writer.add_topic("/x", "nobodys_msgs/msg/X")
    assert write_bag(tmp_path / "empty", []) == 0
    cases = (
        (r"name one with --topic: /left \(.*\), /right \([^)]*\)$", "bag", None),
        (
            r"said: /points: no messages of sensor_msgs/msg/PointCloud2, nor depth images .*: /said \(std_msgs/msg/String, 0\)",
            "said",
            "/points",
        ),
        ("said: no messages of sensor_msgs/msg/PointCloud2, nor depth images .*: /said", "said", None),
        ("empty: no messages of .*: /foretouch/points", "empty", None),
    )
    every_refusal(FileError, cases, lambda name, topic: list(read_bag(tmp_path / name, topic)))


def test_nothing_is_overwritten_or_left_half_and_a_message_that_is_cut_short_is_named(tmp_path, rng):
    (cloud,) = make_clouds(rng, count=1)
    early = Cloud(cloud.xyz, None, "camera", -1)
    with pytest.raises(DatasetError, match="stamp_ns: -1 is before 1970"):
        write_bag(tmp_path / "bag", [cloud, early])
    assert not (tmp_path / "bag").exists()
    (tmp_path / "bag").mkdir()
    with pytest.raises(FileError, match="exists already and is not overwritten"):
        write_bag(tmp_path / "bag", [cloud])
    (tmp_path / "file").write_text("x")
    with pytest.raises(FileError, match="Not a directory"):
        write_bag(tmp_path / "file" / "bag", [cloud])
    xyz = rng.normal(size=(3, 5, 3)).astype(np.float32)
    good = foreign_message(KILTED, xyz, stamp_ns=1)
    bad = foreign_message(KILTED, xyz, stamp_ns=2, width=6)
    write_foreign(tmp_path / "bad", [good, bad, good])
    with pytest.raises(FileError, match=r"bad: /cloud\[1\]: row_step: 112 is less than width 6 x point_step 20"):
        list(read_bag(tmp_path / "bad"))
    with BagWriter(tmp_path / "cut") as writer:
        writer.write(TOPIC, POINT_CLOUD_TYPE, 0, KILTED.serialize_cdr(good, POINT_CLOUD_TYPE)[:100])
    with pytest.raises(FileError, match=r"cut: /foretouch/points\[0\]: truncated or damaged"):
        list(read_bag(tmp_path / "cut"))


def test_what_is_no_recording_is_refused_in_one_line(tmp_path, rng):
    (tmp_path / "notes.txt").write_text("no recording")
    (tmp_path / "folder").mkdir()
    cases = [
        (tmp_path / name, "does not exist|is not a recording: neither") for name in ("absent", "notes.txt", "folder")
    ]
    for suffix in (".mcap", ".db3", ".bag"):
        for number, content in enumerate((b"", b"not what the name says" * 100)):
            (tmp_path / f"{number}{suffix}").write_bytes(content)
            rule = "byte 0: is (empty|not an MCAP file)" if suffix == ".mcap" else "is no .*: it does not begin as one"
            cases.append((tmp_path / f"{number}{suffix}", f"{number}{suffix}: {rule}"))
        os.mkfifo(tmp_path / f"fifo{suffix}")
        cases.append((tmp_path / f"fifo{suffix}", "is a FIFO, not a regular file"))
    (tmp_path / "lonely").mkdir()
    (tmp_path / "lonely" / "metadata.yaml").write_text("rosbag2_bagfile_information: {}")
    cases.append((tmp_path / "lonely", r"lonely: holds none of the files \(.mcap, .db3\)"))

    def check(path: Path, message: str) -> None:
        with pytest.raises(FileError, match=message) as caught:
            list(read_bag(path))
        assert "\n" not in str(caught.value)

    every_case(cases, check)
    assert not any(is_recording(tmp_path / name) for name in ("absent", "notes.txt", "folder"))


def test_the_files_of_a_bag_decide_and_what_its_metadata_states_otherwise_is_told(tmp_path, rng):
    xyz = rng.normal(size=(3, 5, 3)).astype(np.float32)
    messages = [foreign_message(KILTED, xyz + k, stamp_ns=k) for k in range(3)]
    metadata = "bag/metadata.yaml"
    changes = [
        ("another QoS", "offered_qos_profiles: .*", "offered_qos_profiles: '- {history: 1, depth: 3}'", []),
        ("reindexed", "storage_identifier: .*", 'storage_identifier: ""', []),
        ("a type of its own", "type_description_hash: .*", "type_description_hash: RIHS01_00", []),
        ("another count", "message_count: 3", "message_count: 5", ["/cloud: states 5 messages, the files hold 3"]),
        ("another name", "bag\\.(mcap|db3)", "old.mcap", ["does not list bag.", "lists old.mcap, which is absent"]),
        ("no content", "(?s)^.*$", "", [": cannot be read, the files decide"]),
        ("no mapping", "(?s)^.*$", "rosbag2_bagfile_information: 3", [": cannot be read, the files decide"]),
        ("no YAML", "(?s)^.*$", "a: [", [": cannot be read, the files decide"]),
        ("names no texts", "(?s)^.*$", "rosbag2_bagfile_information: {relative_file_paths: [3]}", [": cannot be read"]),
    ]

    def check(name: str, pattern: str, text: str, notes: list[str], plugin: StoragePlugin) -> None:
        folder = tmp_path / f"{name} {plugin.name}"
        folder.mkdir()
        write_foreign(folder / "bag", messages, plugin)
        good = (folder / metadata).read_text()
        changed, count = re.subn(pattern, lambda _: text, good)
        assert count
        (folder / metadata).write_text(changed)
        with Recording(folder / "bag") as recording:
            found = recording.notes
        assert [cloud.stamp_ns for cloud in read_bag(folder / "bag")] == [0, 1, 2]
        assert len(found) == len(notes)
        for line, note in zip(found, notes, strict=True):
            assert line.startswith(str(folder / metadata))
            assert note in line

    every_case([(*change, plugin) for change in changes for plugin in StoragePlugin], check)


def test_each_channel_is_read_by_its_own_encoding_and_known_types_need_no_definition(tmp_path, rng):
    xyz = rng.normal(size=(3, 5, 3)).astype(np.float32)
    path = tmp_path / "mixed.mcap"
    with path.open("wb") as stream:
        writer = McapWriter(stream)
        writer.start("of a fleet", "others")
        cloud = foreign_message(KILTED, xyz, stamp_ns=7)
        cdr = bytes(KILTED.serialize_cdr(cloud, POINT_CLOUD_TYPE))
        old = bytes(NOETIC.serialize_ros1(foreign_message(NOETIC, xyz, stamp_ns=8, seq=1), POINT_CLOUD_TYPE))
        text1 = NOETIC.generate_msgdef(POINT_CLOUD_TYPE)[0].encode()
        kinds = [
            ("/bare", "sensor_msgs/msg/PointCloud2", "", b"", "cdr", cdr),
            ("/short", "sensor_msgs/PointCloud2", "ros2msg", b"", "cdr", cdr),
            ("/ros1", "sensor_msgs/PointCloud2", "ros1msg", text1, "ros1", old),
            ("/json", "sensor_msgs/msg/PointCloud2", "jsonschema", b"{}", "json", b"{}"),
            ("/proto", "foxglove.PointCloud", "protobuf", b"x", "protobuf", b"\x08\x01"),
        ]
        for topic, kind, schema_encoding, text, encoding, data in kinds:
            schema = writer.register_schema(kind, schema_encoding, text)
            writer.add_message(writer.register_channel(topic, encoding, schema), 5, data, 5)
        writer.add_message(writer.register_channel("/plain", "json", 0), 5, b"{}", 5)
        writer.finish()
    stamps = {topic: next(read_bag(path, topic)).stamp_ns for topic in ("/bare", "/short", "/ros1")}
    assert stamps == {"/bare": 7, "/short": 7, "/ros1": 8}
    np.testing.assert_array_equal(next(read_bag(path, "/ros1")).xyz, xyz)
    with Recording(path) as recording:
        types = {topic.name: topic.type for topic in recording.topics}
        assert len(list(recording.messages())) == 6
    assert types["/json"] == "sensor_msgs/msg/PointCloud2 as json"
    assert types["/proto"] == "foxglove.PointCloud as protobuf"
    with pytest.raises(
        FileError,
        match=r"/json: no messages of sensor_msgs/msg/PointCloud2, nor depth images .*: .*/json \(sensor_msgs/msg/PointCloud2 as json, 1\)",
    ):
        list(read_bag(path, "/json"))


def test_compressed_files_without_metadata_are_read_and_an_open_journal_is_named(tmp_path, rng):
    xyz = rng.normal(size=(3, 5, 3)).astype(np.float32)
    messages = [foreign_message(KILTED, xyz, stamp_ns=3)]

    def check(plugin: StoragePlugin, mode: CompressionMode) -> None:
        path = tmp_path / f"{plugin.name}{mode.name}"
        write_foreign(path, messages, plugin, mode)
        (path / "metadata.yaml").unlink()
        (file,) = path.iterdir()
        assert [cloud.stamp_ns for cloud in (*read_bag(path), *read_bag(file))] == [3, 3]
        file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
        with pytest.raises(FileError, match=f"{file.name}: "):
            list(read_bag(path))

    every_case(
        [(plugin, mode) for plugin in StoragePlugin for mode in (CompressionMode.FILE, CompressionMode.MESSAGE)], check
    )
    write_foreign(tmp_path / "open", messages)
    (tmp_path / "open" / "open.db3-wal").write_bytes(b"pages")
    with pytest.raises(FileError, match=r"open.db3: was not closed, and holds messages in open.db3-wal: `sqlite3 "):
        list(read_bag(tmp_path / "open"))


def test_a_type_is_decoded_by_the_definition_of_its_own_file_and_one_without_is_named(tmp_path):
    def write(name: str, text: bytes, data: bytes, time_ns: int) -> None:
        with (tmp_path / name).open("wb") as stream:
            writer = McapWriter(stream)
            writer.start("ros2", "others")
            schema = writer.register_schema("my_msgs/msg/Pair", "ros2msg", text)
            writer.add_message(writer.register_channel("/pairs", "cdr", schema), time_ns, b"\0\1\0\0" + data, time_ns)
            writer.finish()

    write("x_0.mcap", b"int32 a\nint32 b\n", bytes([1, 0, 0, 0, 2, 0, 0, 0]), 5)
    write("x_1.mcap", b"int32 b\nint32 a\n", bytes([1, 0, 0, 0, 2, 0, 0, 0]), 6)
    with Recording(tmp_path) as recording:
        found = [recording.content(message) for message in recording.messages()]
    assert [(one.a, one.b) for one in found] == [(1, 2), (2, 1)]
    write("x_2.mcap", b"my_msgs/Other c\n", bytes(8), 7)
    with (
        Recording(tmp_path) as recording,
        pytest.raises(
            FileError, match=r"/pairs\[2\]: cannot be decoded: the recording does not define my_msgs/msg/Other"
        ),
    ):
        recording.content(list(recording.messages())[2])
