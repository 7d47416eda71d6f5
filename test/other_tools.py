# SPDX-License-Identifier: Apache-2.0
"""Recordings and exports read by other tools than foretouch: Rerun's importers, rosbags, and what Foxglove requires."""

import json
import os
import re
import shutil
import subprocess
from collections import defaultdict
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader

BUILTIN = {
    "bool", "byte", "char", "float32", "float64", "int8", "uint8", "int16", "uint16", "int32", "uint32", "int64",
    "uint64", "string", "wstring",
}  # fmt: skip
TIMES = {"builtin_interfaces/Time", "builtin_interfaces/Duration"}
"""Which Foxglove's parser knows without a definition."""
DRAWN = {"sensor_msgs/msg/PointCloud2", "visualization_msgs/msg/MarkerArray"}


def rosbags_messages(*files: Path) -> dict[str, list[Any]]:
    """The messages of bare MCAP files by topic, decoded by the definitions in them alone."""
    found = defaultdict(list)
    with AnyReader(list(files)) as reader:  # without a default store of types
        for connection, _, data in reader.messages():
            found[connection.topic].append(reader.deserialize(data, connection.msgtype))
    return dict(found)


def run_rerun(folder: Path, *arguments: str | Path) -> str:
    """What a command of Rerun prints, which sends no statistics and keeps its settings in a folder."""
    found = find_spec("rerun_cli")
    if found is None or found.origin is None:
        pytest.skip("Rerun is not installed: pip install 'foretouch[view]'")
    environment = {**os.environ, "XDG_CONFIG_HOME": str(folder), "XDG_DATA_HOME": str(folder), "RERUN_APP_ONLY": "true"}
    for command in (("analytics", "disable"), arguments):
        done = subprocess.run(
            [Path(found.origin).with_name("rerun"), *command],
            env=environment, capture_output=True, text=True, timeout=120.0, check=False,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
    return done.stdout + done.stderr


def rerun_components(path: Path, folder: Path) -> dict[str, set[str]]:
    """What Rerun's importer makes of an MCAP file: components by entity."""
    printed = run_rerun(folder, "mcap", "convert", path, "-o", folder / "imported.rrd")
    faults = [line for line in printed.splitlines() if re.search(r"\b(WARN|ERROR)\b", line) and "app_id" not in line]
    assert not faults  # the name of the file is no name of an application, which every file is told
    components = defaultdict(set)
    printed = run_rerun(folder, "rrd", "print", folder / "imported.rrd")
    for entity, names in re.findall(r"- (/\S*) - data columns: \[(.*)\]", printed):
        components[entity] |= set(names.split())
    return dict(components)


def foxglove_faults(path: Path) -> Iterator[str]:
    """What keeps Foxglove from showing an MCAP file: incomplete schemas, and frames without a transform in time.

    Its 3D panel shows a message of another frame than the displayed one if transforms at or before its stamp connect
    them; here the displayed frame is that of the clouds.
    """
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    for schema in summary.schemas.values():
        if schema.encoding != "ros2msg":
            yield f"{schema.name}: encoding {schema.encoding}"
        yield from _unresolved(schema.name, schema.data.decode())
    messages = rosbags_messages(path)
    known: dict[str, int] = {}
    for topic in ("/tf", "/tf_static"):
        for message in messages.get(topic, ()):
            for one in message.transforms:
                for frame in (one.header.frame_id, one.child_frame_id):
                    known[frame] = min(known.get(frame, 2**63), _ns(one.header.stamp))
    clouds = {message.header.frame_id for message in messages.get("/foretouch/object_cloud", ())}
    for topic, received in messages.items():
        for message in received if received[0].__msgtype__ in DRAWN else ():
            for header in [getattr(message, "header", None), *(one.header for one in getattr(message, "markers", ()))]:
                frame = getattr(header, "frame_id", "")
                if frame and header is not None and frame not in clouds and known.get(frame, 2**63) > _ns(header.stamp):
                    yield f"{topic}: frame {frame} has no transform at or before {_ns(header.stamp)}"


def _unresolved(name: str, text: str) -> Iterator[str]:
    """Types in a schema whose definition it does not hold."""
    first, *others = re.split(r"^=+\nMSG: (\S+)\n", text, flags=re.MULTILINE)
    defined = {name.replace("/msg/", "/"): first} | dict(zip(others[::2], others[1::2], strict=True))
    for owner, content in defined.items():
        for line in content.splitlines():
            field = re.match(r"([\w/]+)(?:<=\d+)?(?:\[[^]]*\])?\s+\w+", line.split("#")[0].strip())
            if field is None or field[1] in BUILTIN or field[1] in TIMES:
                continue
            kind = field[1] if "/" in field[1] else f"{owner.split('/')[0]}/{field[1]}"
            if kind.replace("/msg/", "/") not in {one.replace("/msg/", "/") for one in defined} | TIMES:
                yield f"{name}: {kind} is not defined"


def _ns(stamp: Any) -> int:
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


_FOXGLOVE = """
import { readFileSync } from "fs";
import { McapStreamReader } from "@mcap/core";
import rosmsg from "@foxglove/rosmsg";
import serialization from "@foxglove/rosmsg2-serialization";

const reader = new McapStreamReader({ validateCrcs: true });
const decoders = new Map(), channels = new Map(), counts = {};
reader.append(readFileSync(process.argv[2]));
for (let record; (record = reader.nextRecord()); ) {
  if (record.type === "Schema") {
    const definitions = rosmsg.parse(new TextDecoder().decode(record.data), { ros2: true });
    decoders.set(record.id, new serialization.MessageReader(definitions));
  } else if (record.type === "Channel") {
    channels.set(record.id, record);
  } else if (record.type === "Message") {
    const channel = channels.get(record.channelId);
    decoders.get(channel.schemaId).readMessage(record.data);
    counts[channel.topic] = (counts[channel.topic] ?? 0) + 1;
  }
}
console.log(JSON.stringify(counts));
"""


def foxglove_counts(path: Path, folder: Path) -> dict[str, int]:
    """Messages by topic of an MCAP file, each decoded by the libraries that the Foxglove application uses."""
    if shutil.which("npm") is None:
        pytest.skip("Foxglove's libraries need npm")
    packages = ("@mcap/core", "@foxglove/rosmsg", "@foxglove/rosmsg2-serialization")
    command = ["npm", "install", "--no-audit", "--no-fund", "--ignore-scripts", "--fetch-retries=0", *packages]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=100.0, check=False)
    if done.returncode:
        pytest.skip(f"Foxglove's libraries cannot be installed: {done.stderr.strip().splitlines()[-1]}")
    (folder / "read.mjs").write_text(_FOXGLOVE)
    command = ["node", str(folder / "read.mjs"), str(path)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120.0, check=True)
    return dict(json.loads(done.stdout))
