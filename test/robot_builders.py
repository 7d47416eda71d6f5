# SPDX-License-Identifier: Apache-2.0
"""A robot for the tests of the recorder: it sends what a grasp looks and feels like, with stamps that it chooses."""

import time
from pathlib import Path
from typing import Any

import numpy as np
from pair_builders import REST, level
from sensor_msgs.msg import PointCloud2

from foretouch.ros.messages.clouds import objects_to_msg
from foretouch.ros.messages.conversions import grasp_to_msg, header_to_msg, stamp_to_msg
from foretouch.types import ASSUMED_TABLE, Cloud, Grasp
from foretouch.types.scene import Object
from foretouch_lab.ros.hand_messages import biotac_all_to_msg
from foretouch_msgs.msg import BiotacAll, ExecutedGrasp, GraspArray, RecorderStatus

MS = 1_000_000
FRAME = "camera_depth_optical_frame"
QUICK = {
    "pairing__guard_s": 0.02,
    "pairing__tare_s": 0.2,
    "pairing__wait_s": 1.0,
    "pairing__clock_s": 10.0,  # the robot below is in a hurry: its stamps run ahead of the clock
}


class Robot:
    """A camera, a planner and a hand in one: publishes what a grasp looks like, with stamps that it chooses."""

    tactile: type = BiotacAll
    rest, level = REST, staticmethod(level)  # values without contact, and in that of a grasp by its number
    noise = np.r_[0.3, 0.3, np.full(48, 4.0)]

    def __init__(self, graph: Any) -> None:
        self.clouds = graph.talk(PointCloud2, "object_cloud")
        self.grasps = graph.talk(GraspArray, "grasps")
        self.hand = graph.talk(self.tactile, "/rh/tactile")
        self.told = graph.talk(ExecutedGrasp, "executed_grasp")
        for topic in ("object_cloud", "grasps", "/rh/tactile", "executed_grasp"):
            graph.matched(topic)
        self.now = time.time_ns()
        self.sent = {"/rh/tactile": 0, "object_cloud": 0, "grasps": 0, "executed_grasp": 0}
        self._rng = np.random.default_rng(0)

    def see(self, name: str) -> None:
        """A cloud whose points tell the grasp, and a grasp planned on it."""
        xyz = (0.03 * self._rng.normal(size=(300, 3)) + [0.0, 0.0, 0.5]).astype(np.float32)
        self.cloud = Cloud(xyz, None, FRAME, self.now)
        self.clouds.publish(objects_to_msg([Object.of("7", self.cloud, ASSUMED_TABLE)], FRAME, self.now))
        along = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])  # its Z along y
        grasp = Grasp(np.array([0.0, 0.03, 0.5]), np.array([0.0, -0.03, 0.5]), along, 1.0, name, "7")
        other = Grasp(np.array([0.0, 0.02, 0.5]), np.array([0.0, -0.02, 0.5]), along, 0.5, f"{name} too", "7")
        messages = [grasp_to_msg(grasp), grasp_to_msg(other)]
        self.grasps.publish(GraspArray(header=header_to_msg(FRAME, self.now), grasps=messages))
        self.sent["object_cloud"] += 1
        self.sent["grasps"] += 1

    def feel(self, counts: np.ndarray, readings: int) -> None:
        """So many readings at 100 Hz by the stamps, as fast as they can be sent."""
        for _ in range(readings):
            noisy = np.round(counts + self._rng.normal(0, 1, len(counts)) * self.noise)
            self.hand.publish(self.message(noisy.astype(np.int16)))
            self.now += 10 * MS
            self.sent["/rh/tactile"] += 1
            time.sleep(0.001)

    def message(self, counts: np.ndarray) -> Any:
        """(D,) int16 counts of now as a message of the hand."""
        fingers = {"TH": np.r_[counts[0], counts[2:26]], "MF": np.r_[counts[1], counts[26:]]}
        return biotac_all_to_msg(fingers, "rh", self.now)

    def grasp(self, name: str, number: int, *, tell: bool = True) -> dict[str, Any]:
        """Rest, approach, hold, release; gives the times."""
        self.now = max(self.now, time.time_ns() - 700 * MS)  # what is felt below is then stamped about now
        self.see(name)
        self.now += MS
        self.feel(self.rest, 40)
        times = {"start": stamp_to_msg(self.now)}
        self.feel(self.rest, 5)
        times["contact"] = stamp_to_msg(self.now)
        self.feel(self.level(number), 20)
        times["release"] = stamp_to_msg(self.now)
        self.feel(self.rest, 10)
        if tell:
            self.report(name, times)
        return times

    def report(self, name: str, times: dict[str, Any], *, success: bool = True) -> None:
        """Tell that a grasp was executed."""
        self.told.publish(ExecutedGrasp(header=header_to_msg(FRAME, self.now), grasp_id=name, success=success, **times))
        self.sent["executed_grasp"] += 1


class RecordedRobot(Robot):
    """The same beside a recorder."""

    def __init__(self, graph: Any, node: Any) -> None:
        super().__init__(graph)
        self.graph, self.node = graph, node

    def record(self, name: str, number: int) -> None:
        """A grasp that becomes one more sample of the session."""
        wanted = self.node.status().samples + 1
        self.grasp(name, number)
        self.graph.until(lambda: self.node.status().samples == wanted)


def start(graph: Any, path: Path, **parameters: Any) -> tuple[Any, RecordedRobot, list[Any]]:
    told = graph.listen(RecorderStatus, "recorder_status")
    (node,) = graph.add("recorder", record=str(path), folder=str(path.parent), object="can", **{**QUICK, **parameters})
    assert node.state_name == "active"
    return node, RecordedRobot(graph, node), told


def outcomes(status: Any) -> dict[str, int]:
    return dict(zip(status.outcomes, status.outcome_counts, strict=True))


def accounts(status: Any) -> dict[str, Any]:
    return {topic.topic.removeprefix("/foretouch/"): topic for topic in status.topics}
