# SPDX-License-Identifier: Apache-2.0
"""How often does the best grasp jump while nothing moves but the camera's noise? See README.md."""

import time
from argparse import Namespace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.common import Rows, command, scene
from foretouch.grasp import GraspHold, GraspPlan, HeldGrasp
from foretouch.pipeline import FoundObject, Pipeline, PipelineConfig
from foretouch.ros.nodes.grasp import HOLD_TOLERANCE_M, GraspNodeConfig
from foretouch.types import Float64
from foretouch_lab.simulation.scene_camera import FrameMaker

# Of each scene, the sample with this number.
SCENES = (("rigid", 0), ("rigid", 3), ("deformables", 2), ("deformables", 3), ("unseen_objects", 0))
# The middle of a D415's image of 848 x 480 pixels and 65 degrees: the table and the object are in it.
CAMERA = {"camera.width": 480, "camera.height": 320, "camera.hfov_deg": 39.67}
JUMP_M = 0.005
RATE_HZ = 30.0


class Stream:
    """The best grasps of one method in one stream of clouds, as the nodes `segmentation` and `grasp` make them."""

    def __init__(self, method: str, hold: float) -> None:
        self._method, self._margin = method, hold
        self._pipeline = Pipeline(PipelineConfig.from_mapping({"grasp": {"method": method}}))
        self._hold = GraspHold(HOLD_TOLERANCE_M)
        self._contacts: list[Float64] = []
        self._scores: list[float] = []
        self._ms: list[float] = []

    def see(self, target: FoundObject, segmented_s: float) -> None:
        """Plan on the next cloud."""
        start = time.thread_time()
        plan = self._plan(target)
        self._ms.append((segmented_s + time.thread_time() - start) * 1e3)
        if plan.grasps:
            self._contacts.append(np.stack([plan.grasps[0].g1, plan.grasps[0].g2]))
            self._scores.append(plan.grasps[0].score)

    def _plan(self, target: FoundObject) -> GraspPlan:
        if self._margin == 0.0:
            return self._pipeline.plan(target)
        plan = self._pipeline.plan(target, held=self._hold.find(target.cloud), hold=self._margin)
        if plan.grasps and plan.axis is not None:
            self._hold.remember(target.cloud, HeldGrasp(plan.grasps[0], plan.axis, plan.outdone))
        self._hold.next_cloud()
        return plan

    def row(self) -> dict[str, Any]:
        """The figures of the stream."""
        moves = np.linalg.norm(np.diff(self._contacts, axis=0), axis=2).max(axis=1)
        return {
            "frames": len(self._ms), "method": self._method, "hold": f"{self._margin:g}", "jumps": int((moves > JUMP_M).sum()),
            "largest_mm": f"{moves.max() * 1e3:.2f}", "score": f"{np.nanmean(self._scores):.3f}", "cpu_ms": f"{np.median(self._ms):.1f}",
            "cpu_p95_ms": f"{np.percentile(self._ms, 95):.1f}", "answered": len(self._contacts),
        }  # fmt: skip


def watch(name: str, slot: int, frames: int) -> list[dict[str, Any]]:
    """The rows of one still scene, one for each method."""
    maker, pipeline = FrameMaker(scene(name).updated(CAMERA)), Pipeline()
    streams = [Stream("original", 0.0), Stream("completed", GraspNodeConfig().grasp_hold)]
    previous = None
    for frame in range(frames):
        cloud = maker.frame(slot, repeat=frame).cloud(stamp_ns=round(frame / RATE_HZ * 1e9))
        start = time.thread_time()
        found = pipeline.segment(cloud, previous)
        segmented_s = time.thread_time() - start
        if not found.targets:
            continue
        target = found.targets[0]
        previous = target.cloud.xyz.mean(axis=0, dtype=np.float64)
        for stream in streams:
            stream.see(target, segmented_s)
    return [{"scene": f"{name} {slot}", **stream.row()} for stream in streams]


def tables(arguments: Namespace) -> dict[Path, Rows]:
    """The one table."""
    chosen = [(arguments.scene[0], int(arguments.scene[1]))] if arguments.scene else SCENES
    return {Path(__file__).parent / "still.csv": (row for one in chosen for row in watch(*one, arguments.frames))}


if __name__ == "__main__":
    one_scene = {"nargs": 2, "metavar": ("NAME", "SAMPLE"), "help": "only this one"}
    command(__doc__, tables, {"--frames": {"type": int, "default": 300}, "--scene": one_scene})
