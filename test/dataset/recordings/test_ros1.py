# SPDX-License-Identifier: Apache-2.0
"""Hands on ROS 1: the rules of ros1_bridge against the ROS 1 definitions, and bags that were recorded on Noetic."""

import re
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest
import yaml
from every_case import every_case
from rosbags.highlevel import AnyReader
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from topic_builders import write_topics

from foretouch.dataset.formats import open_samples
from foretouch.dataset.identity import Identity
from foretouch.dataset.importing import import_samples
from foretouch.dataset.recordings.sample_codec import encode_sample

PACKAGE = Path(__file__).parents[3] / "foretouch_msgs"
IDENTITY = Identity(hand={"name": "shadow"}, camera={"name": "D415"})
ALL = "std_msgs/Header header\nBiotac[5] tactiles\n"
NOETIC = "int16 pac0\nint16 pac1\nint16[] pac\nint16 pdc\nint16 tac\nint16 tdc\nint16[] electrodes\n"
BEFORE_2019 = NOETIC.replace("int16[] pac\n", "")
DEFINITIONS = {  # the fields of sr_robot_msgs/Biotac by version, with the MD5 of BiotacAll that ROS 1 tells them apart by
    "0022d8afb0897596a0c41f523836ee37": NOETIC,
    "e27dd065f854b80a2d092dd322ddfd40": BEFORE_2019,
    "47a346cfb98ba8199f53056f3ea612f1": BEFORE_2019.replace("int16[] electrodes", "int16[19] electrodes"),
}
"""The last MD5 is that of the header files that rosserial generated for BioTacs with 19 electrodes."""


def ros1_store(biotac: str):
    store = get_typestore(Stores.ROS1_NOETIC)
    store.register(get_types_from_msg(biotac, "sr_robot_msgs/msg/Biotac"))
    store.register(get_types_from_msg(ALL, "sr_robot_msgs/msg/BiotacAll"))
    return store


def fields_of(text: str) -> dict[str, str]:
    """Types of the fields of a definition by name; the size of a list and the package of a message do not count."""
    found = re.findall(r"^([\w/]+(?:\[\d*\])?)\s+(\w+)", re.sub(r"#.*", "", text), re.MULTILINE)
    return {name: re.sub(r"^int16\[\d*\]", "int16[]", kind.removeprefix("std_msgs/")) for kind, name in found}


def test_the_rules_of_the_bridge_match_every_version_of_the_messages_field_by_field() -> None:
    rules = yaml.safe_load((PACKAGE / "mapping_rules.yaml").read_text())
    assert {(rule["ros1_package_name"], rule["ros2_package_name"]) for rule in rules} == {
        ("sr_robot_msgs", "foretouch_msgs")
    }
    pairs = {rule["ros1_message_name"]: rule["ros2_message_name"] for rule in rules}
    assert pairs == {"Biotac": "Biotac", "BiotacAll": "BiotacAll"}  # the message in it needs a rule too
    (exported,) = ET.parse(PACKAGE / "package.xml").getroot().iterfind("export/ros1_bridge")
    assert exported.attrib == {"mapping_rules": "mapping_rules.yaml"}
    assert re.search(r"install\(FILES mapping_rules\.yaml DESTINATION share/", (PACKAGE / "CMakeLists.txt").read_text())

    def check(md5: str, biotac: str) -> None:
        assert ros1_store(biotac).generate_msgdef("sr_robot_msgs/msg/BiotacAll", ros_version=1)[1] == md5
        for name, text in (("Biotac", biotac), ("BiotacAll", ALL)):
            ros1, ros2 = fields_of(text), fields_of((PACKAGE / "msg" / f"{pairs[name]}.msg").read_text())
            assert ros1.items() <= ros2.items()  # the bridge refuses messages that each lack a field of the other
            assert ros2.keys() - ros1.keys() <= {"pac"}
            assert list(ros1) == [field for field in ros2 if field in ros1]

    every_case(DEFINITIONS.items(), check)


def write_noetic(source: Path, path: Path, biotac: str) -> None:
    """A bag of ROS 2 as ROS 1 records the same messages, with those of the hand as `sr_robot_msgs`."""
    store = ros1_store(biotac)
    with AnyReader([source]) as reader, Writer(path) as writer:
        store.register({
            name: reader.typestore.fielddefs[name]
            for name in ("foretouch_msgs/msg/Grasp", "foretouch_msgs/msg/GraspArray", "foretouch_msgs/msg/ExecutedGrasp")
        })  # fmt: skip
        connections = {}
        for connection, time_ns, data in reader.messages():
            message = reader.deserialize(data, connection.msgtype)
            kind = connection.msgtype.replace("foretouch_msgs/msg/Biotac", "sr_robot_msgs/msg/Biotac")
            message.header.__dict__["seq"] = 7
            if connection.topic not in connections:
                connections[connection.topic] = writer.add_connection(connection.topic, kind, typestore=store)
            writer.write(connections[connection.topic], time_ns, bytes(store.serialize_ros1(message, kind)))


@pytest.mark.parametrize("biotac", [NOETIC, BEFORE_2019], ids=["noetic", "before_2019"])
def test_a_bag_of_noetic_gives_the_samples_of_the_same_bag_of_ros_2(tmp_path: Path, biotac: str) -> None:
    write_topics(tmp_path / "bag")
    write_noetic(tmp_path / "bag", tmp_path / "noetic.bag", biotac)
    samples = []
    for name in ("bag", "noetic.bag"):
        result = import_samples(tmp_path / name, tmp_path / f"{name} imported", identity=IDENTITY)
        assert (result.samples, result.labelled) == (2, 1)
        records = open_samples(tmp_path / f"{name} imported")
        samples.append([encode_sample(record, IDENTITY) for record in records])
    assert samples[0] == samples[1]
