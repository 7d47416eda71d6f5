# SPDX-License-Identifier: Apache-2.0
"""The example planner, as a user runs it, against live nodes."""

import os
import re
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from sensor_msgs.msg import PointCloud2

from foretouch.ros.executables import PERCEPTION
from foretouch.ros.messages.clouds import cloud_to_msg

pytestmark = [pytest.mark.ros, pytest.mark.slow]

EXAMPLE = Path(__file__).parents[2] / "examples" / "rank_grasps.py"


def test_the_planner_ranks_fifty_grasps(graph, scene_cloud, model_card):
    graph.add(*PERCEPTION, model=model_card)
    publisher = graph.talk(PointCloud2, "points")
    graph.matched("points")
    done = threading.Event()

    def camera():
        for stamp in range(1, 1000):
            publisher.publish(cloud_to_msg(scene_cloud(stamp_ns=stamp)))
            if done.wait(0.3):
                return

    thread = threading.Thread(target=camera)
    thread.start()
    try:
        result = subprocess.run(
            [sys.executable, EXAMPLE],
            env={**os.environ, "ROS_DOMAIN_ID": str(graph.domain)},
            capture_output=True,
            text=True,
            timeout=60,
            check=False,
        )
    finally:
        done.set()
        thread.join()
    assert result.returncode == 0, result.stderr
    assert re.match(r"(4\d|50) of 50 grasps predicted; the gentlest is \d+:", result.stdout), result.stdout
    assert "PDC thumb" in result.stdout
    assert "nan" not in result.stdout
