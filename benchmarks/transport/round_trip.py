# SPDX-License-Identifier: Apache-2.0
"""Round trips of `predict_touch` beside a graph, of this version and of another checkout in turns (see README.md).

Each version has its graph and its client, which are processes of its own environment and in a ROS domain of their own. This file is
the client of both: as a program, it answers each line `COUNT ORIENTED` with a line of JSON.
"""

import json
import os
import subprocess
import sys
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np

COUNTS = (1, 10, 100, 1000)
TIMEOUT_S = 120.0
_START = (
    "import sys; from foretouch.ros.executables import run; "
    "sys.exit(run('segmentation', 'grasp', 'touch_predictor', args=[sys.argv[0], '--ros-args']))"
)


def scene(points: int = 3000) -> tuple[Any, Any, Any]:
    """(points, 3) float32 the visible half of a standing cylinder, (1000, 6) contacts at its sides [m], camera frame, and (1000, 3, 3) their hands."""
    rng, radius = np.random.default_rng(0), 0.03
    angle, height = rng.uniform(0.0, np.pi, points), rng.uniform(-0.06, 0.06, points)
    xyz = np.column_stack([radius * np.cos(angle), height, 0.8 - radius * np.sin(angle)])
    contacts = np.zeros((max(COUNTS), 2, 3))
    contacts[:, 0, 0], contacts[:, 1, 0] = radius, -radius
    contacts += rng.normal(0.0, 0.002, contacts.shape)
    contacts[:, :, 2] += 0.8
    contacts[:, :, 1] += rng.uniform(-0.05, 0.05, (len(contacts), 1))
    z = contacts[:, 0] - contacts[:, 1]
    z /= np.linalg.norm(z, axis=1)[:, None]
    x = np.cross(z, [0.0, -1.0, 0.0])
    x /= np.linalg.norm(x, axis=1)[:, None]
    return xyz.astype(np.float32), contacts.reshape(-1, 6), np.stack([x, np.cross(z, x), z], axis=2)


def serve() -> int:
    """Answer lines of the standard input until it ends: the time of a round trip [ms], and the predictions as float32."""
    from foretouch.ros.runtime.environment import prepare_environment

    prepare_environment()
    import rclpy
    from sensor_msgs.msg import PointCloud2, PointField
    from shape_msgs.msg import Plane

    from foretouch_msgs.srv import PredictTouch

    rclpy.init()
    node = rclpy.create_node("round_trip", namespace="/foretouch")
    client = node.create_client(PredictTouch, "predict_touch")
    xyz, contacts, rotations = scene()
    fields = [PointField(name=name, offset=4 * k, datatype=7, count=1) for k, name in enumerate("xyz")]
    cloud = PointCloud2(
        height=1, width=len(xyz), fields=fields, point_step=12, row_step=12 * len(xyz), data=xyz.tobytes()
    )
    cloud.header.frame_id = "camera_depth_optical_frame"
    table = Plane(coef=[0.0, -1.0, 0.0, 0.06])  # below the cylinder; y points down
    if not client.wait_for_service(TIMEOUT_S):
        raise SystemExit("predict_touch: no such service")
    for line in sys.stdin:
        count, oriented = int(line.split()[0]), line.split()[1] == "True"
        request = PredictTouch.Request(cloud=cloud, table=[] if oriented else [table])
        request.contacts = contacts[:count].ravel()
        request.rotations = rotations[:count].ravel() if oriented else []
        began = time.perf_counter()
        future = client.call_async(request)
        rclpy.spin_until_future_complete(node, future, timeout_sec=TIMEOUT_S)
        took = 1e3 * (time.perf_counter() - began)
        if not future.done():
            raise SystemExit(f"predict_touch: no answer within {TIMEOUT_S:g} s")
        batch = future.result().batch
        print(json.dumps({"ms": took, "values": [*map(float, batch.scalars), *map(float, batch.values)]}), flush=True)
    return 0


class _Version:
    """The graph and the client of one checkout, while the context is open."""

    def __init__(self, root: Path, domain: int, stack: ExitStack) -> None:
        python = root / ".venv/bin/python"
        kept = {name: os.environ[name] for name in ("PATH", "HOME") if name in os.environ}  # nothing of this venv
        environment = kept | {"ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "cwd": root, "env": environment}
        graph = subprocess.Popen([python, "-c", _START], **quiet)
        stack.callback(graph.wait, 30.0)
        stack.callback(graph.terminate)
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True, "cwd": root, "env": environment}
        self._client = subprocess.Popen([python, Path(__file__).resolve()], **pipes)
        stack.callback(self._client.wait, 30.0)
        stack.callback(self._client.stdin.close)

    def ask(self, count: int, *, oriented: bool) -> dict[str, Any]:
        self._client.stdin.write(f"{count} {oriented}\n")
        self._client.stdin.flush()
        if not (line := self._client.stdout.readline()):
            raise SystemExit("a client of the round trips ended")
        found: dict[str, Any] = json.loads(line)
        return found


def compare(old: Path, new: Path, domain: int, rounds: int = 20) -> list[dict[str, Any]]:
    """Rows of the least and the median round trip of both checkouts by the number of grasps, asked in turns.

    Predictions must be equal to the last bit of a float32 where the orientations are given.
    """
    rows = []
    with ExitStack() as stack:
        versions = {"old": _Version(old, domain, stack), "new": _Version(new, domain + 1, stack)}
        for oriented in (True, False):
            for count in COUNTS:
                times: dict[str, list[float]] = {name: [] for name in versions}
                for _ in range(rounds + 1):
                    found = {name: one.ask(count, oriented=oriented) for name, one in versions.items()}
                    if oriented and found["old"]["values"] != found["new"]["values"]:
                        raise SystemExit(f"{count} grasps: the predictions of both versions differ")
                    for name, one in found.items():
                        times[name].append(one["ms"])
                row: dict[str, Any] = {"grasps": count, "orientations": "given" if oriented else "computed"}
                for what, of in (("best", np.min), ("median", np.median)):
                    taken = {name: float(of(values[1:])) for name, values in times.items()}  # the first warms up
                    row |= {f"{name}_{what}_ms": f"{ms:.3g}" for name, ms in taken.items()}
                    row[f"{what}_ratio"] = f"{taken['new'] / taken['old']:.3f}"
                rows.append(row)
                print(row, flush=True)
    return rows


if __name__ == "__main__":
    sys.exit(serve())
