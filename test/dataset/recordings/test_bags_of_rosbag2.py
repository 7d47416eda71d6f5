# SPDX-License-Identifier: Apache-2.0
"""Bags that rosbag2 itself has written, those of its own tests: `ROSBAG2` names a checkout of github.com/ros2/rosbag2."""

import os
import re
from pathlib import Path

import pytest
import yaml
from every_case import every_case

from foretouch.dataset.source import open_source
from foretouch.errors import ForetouchError

ROSBAG2 = os.environ.get("ROSBAG2", "")
pytestmark = pytest.mark.skipif(not ROSBAG2, reason="bags of rosbag2: set ROSBAG2 to a checkout of ros2/rosbag2")


def test_topics_types_and_counts_are_those_that_rosbag2_has_noted() -> None:
    """None holds a cloud, so that the refusal lists what each holds."""

    def check(folder: Path) -> None:
        noted = yaml.safe_load((folder / "metadata.yaml").read_text(encoding="utf-8"))["rosbag2_bagfile_information"]
        with pytest.raises(ForetouchError, match="no messages of sensor_msgs/msg/PointCloud2") as refused:
            open_source(folder)
        told = re.findall(r"([\w/]+) \(([\w/]+), (\d+)\)", str(refused.value))
        wanted = [
            (topic["topic_metadata"]["name"], topic["topic_metadata"]["type"], str(topic["message_count"]))
            for topic in noted["topics_with_message_count"]
        ]
        assert (len(wanted) > 0, sorted(told)) == (True, sorted(wanted))

    kept = Path(ROSBAG2).glob("rosbag2_*/**/resources/**/metadata.yaml")
    bags = {str(path.parent.relative_to(ROSBAG2)): path.parent for path in kept if any(path.parent.glob("*.[md][cb]*"))}
    bags = {name: bag for name, bag in bags.items() if "wrong_rmw" not in name}  # in a made-up serialisation
    assert {name.split("/")[3] for name in bags if name.startswith("rosbag2_py")} >= {"mcap", "sqlite3"}
    every_case(bags, check)
