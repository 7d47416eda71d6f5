# SPDX-License-Identifier: Apache-2.0
"""Recordings and exports read by other tools than foretouch: Rerun's importers and rosbags."""

import os
import re
import subprocess
from collections import defaultdict
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest
from rosbags.highlevel import AnyReader


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
