# SPDX-License-Identifier: Apache-2.0
"""Recordings that would unpack to gigabytes, or of which a query would not end."""

import bz2
import sqlite3
import struct
from pathlib import Path

import numpy as np
import pytest
import zstandard
from depth_builders import STAMP_NS, image, info, write_bag
from every_case import every_case
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.typesys import Stores, get_typestore

from foretouch.dataset.recordings.bag import Recording
from foretouch.errors import FileError

TABLES = """CREATE TABLE schema(schema_version INTEGER PRIMARY KEY, ros_distro TEXT NOT NULL);
CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT, offered_qos_profiles TEXT, type_description_hash TEXT);
CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB);
INSERT INTO schema VALUES (4, 'x');
INSERT INTO topics VALUES (1, '/a', 'std_msgs/msg/String', 'cdr', '', '');
"""
DEFINITIONS = "CREATE TABLE message_definitions(id INTEGER PRIMARY KEY, topic_type TEXT, encoding TEXT, encoded_message_definition TEXT, type_description_hash TEXT);"
ENDLESS = (
    "CREATE VIEW message_definitions AS WITH RECURSIVE c(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM c) SELECT "
    "'a' AS topic_type, 'ros2msg' AS encoding, 'b' AS encoded_message_definition, '' AS type_description_hash, x AS id FROM c;"
)


def database(path: Path, *statements: str) -> Path:
    with sqlite3.connect(path) as made:
        made.executescript("".join([TABLES, *statements]))
    return path


def shared_pages(path: Path) -> Path:
    """A database of some hundred kilobytes whose tree has the same pages below each other page, and so millions of rows."""
    each = "".join(f"INSERT INTO messages VALUES ({number}, 1, {number}, zeroblob(900));" for number in range(1, 3000))
    rows = f"BEGIN; {each} COMMIT;"
    database(path, DEFINITIONS, rows)
    with sqlite3.connect(path) as made:
        (root,) = made.execute("SELECT rootpage FROM sqlite_master WHERE name = 'messages'").fetchone()
        (size,) = made.execute("PRAGMA page_size").fetchone()
    data = bytearray(path.read_bytes())
    top = bytes(data[(root - 1) * size : root * size])
    count = struct.unpack_from(">H", top, 3)[0]
    places = struct.unpack_from(f">{count}H", top, 12)
    last = len(data) // size
    levels = [root, *range(last - 20, last - 4)]
    below = [*levels[1:], struct.unpack_from(">I", top, places[0])[0]]
    for page, child in zip(levels, below, strict=True):
        changed = bytearray(top)
        for place in places:
            struct.pack_into(">I", changed, place, child)
        struct.pack_into(">I", changed, 8, child)
        data[(page - 1) * size : page * size] = changed
    path.write_bytes(data)
    return path


def test_databases_without_end_are_refused(tmp_path: Path) -> None:
    cases = {
        "an endless view": (database(tmp_path / "view.db3", ENDLESS), "view.db3: message_definitions: is a view that no recorder"),
        "a trigger": (database(tmp_path / "trigger.db3", DEFINITIONS, "CREATE TRIGGER t AFTER INSERT ON topics BEGIN SELECT 1; END;"), "t: is a trigger that no"),
        "shared pages": (shared_pages(tmp_path / "shared.db3"), "shared.db3: has more rows than its .* bytes can hold"),
    }  # fmt: skip

    def check(path: Path, rule: str) -> None:
        with pytest.raises(FileError, match=rule):
            Recording(path)

    every_case(cases, check)


def test_what_unpacks_to_far_more_than_its_size_is_refused(tmp_path: Path) -> None:
    packed = zstandard.ZstdCompressor().compress(bytes(64_000_000))
    (tmp_path / "a.db3.zstd").write_bytes(packed)
    with pytest.raises(FileError, match=r"a\.db3\.zstd: the file of \d+ bytes unpacks to more than 32000000"):
        Recording(tmp_path / "a.db3.zstd")
    sent = [
        ("/depth/image", STAMP_NS, image(np.full((48, 84), 700, np.uint16), "16UC1")),
        ("/depth/camera_info", STAMP_NS, info()),
    ]
    write_bag(tmp_path / "bag", sent)
    file = next((tmp_path / "bag").glob("*.db3"))
    with sqlite3.connect(file) as made:
        made.execute("UPDATE messages SET data = ?", [zstandard.ZstdCompressor().compress(bytes(210_000_000))])
    with (
        Recording(file) as recording,
        pytest.raises(FileError, match=r"a message of .* bytes unpacks to more than 200000000"),
    ):
        next(recording.messages())


def test_a_chunk_of_ros1_unpacks_within_a_limit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    store = get_typestore(Stores.ROS1_NOETIC)
    text = store.types["std_msgs/msg/String"](data="x" * 3_000_000)
    writer = Ros1Writer(tmp_path / "a.bag")
    writer.set_compression(Ros1Writer.CompressionFormat.BZ2)
    with writer:
        connection = writer.add_connection("/a", "std_msgs/msg/String", typestore=store)
        writer.write(connection, 1, store.serialize_ros1(text, "std_msgs/msg/String"))
    assert len(bz2.compress(bytes(3_000_000))) < 1000
    with Recording(tmp_path / "a.bag") as recording:
        assert len(next(recording.messages()).data) > 3_000_000
    monkeypatch.setattr("foretouch.dataset.recordings.bag_files._MESSAGE", 1_000_000)
    with (
        Recording(tmp_path / "a.bag") as recording,
        pytest.raises(FileError, match=r"a chunk of .* bytes unpacks to more than 1000000"),
    ):
        next(recording.messages())
