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
NODES = ("segmentation", "grasp", "touch_predictor")
TIMEOUT_S = 120.0
_RADIUS_M, _DISTANCE_M = 0.03, 0.8


def scene(points: int = 3000) -> tuple[Any, Any]:
    """(points, 3) float32 the visible half of a standing cylinder, and (1000, 6) contacts at its sides [m], camera frame."""
    rng = np.random.default_rng(0)
    angle, height = rng.uniform(0.0, np.pi, points), rng.uniform(-0.06, 0.06, points)
    xyz = np.column_stack([_RADIUS_M * np.cos(angle), height, _DISTANCE_M - _RADIUS_M * np.sin(angle)])
    contacts = np.zeros((max(COUNTS), 2, 3))
    contacts[:, 0, 0], contacts[:, 1, 0] = _RADIUS_M, -_RADIUS_M
    contacts += rng.normal(0.0, 0.002, contacts.shape)
    contacts[:, :, 2] += _DISTANCE_M
    contacts[:, :, 1] += rng.uniform(-0.05, 0.05, (len(contacts), 1))
    return xyz.astype(np.float32), contacts.reshape(-1, 6)


def rotations(contacts: Any) -> Any:
    """(K, 3, 3) of hands at (K, 6) contacts, for an upright object: Z = g1 - g2, X = Z x (0, -1, 0)."""
    z = contacts[:, :3] - contacts[:, 3:]
    z /= np.linalg.norm(z, axis=1)[:, None]
    x = np.cross(z, [0.0, -1.0, 0.0])
    x /= np.linalg.norm(x, axis=1)[:, None]
    return np.stack([x, np.cross(z, x), z], axis=2)


class _Requests:
    """The client, in whose environment the messages are those of its version."""

    def __init__(self) -> None:
        from foretouch.ros.runtime.environment import prepare_environment

        prepare_environment()
        import rclpy
        from sensor_msgs.msg import PointCloud2, PointField
        from shape_msgs.msg import Plane

        from foretouch_msgs.srv import PredictTouch

        rclpy.init()
        self._rclpy, self._kind = rclpy, PredictTouch
        self._node = rclpy.create_node("round_trip", namespace="/foretouch")
        self._client = self._node.create_client(PredictTouch, "predict_touch")
        xyz, self._contacts = scene()
        fields = [
            PointField(name=name, offset=4 * k, datatype=PointField.FLOAT32, count=1) for k, name in enumerate("xyz")
        ]
        self._cloud = PointCloud2(
            height=1, width=len(xyz), fields=fields, point_step=12, row_step=12 * len(xyz), data=xyz.tobytes()
        )
        self._cloud.header.frame_id = "camera_depth_optical_frame"
        self._table = Plane(coef=[0.0, -1.0, 0.0, 0.06])  # below the cylinder; y points down
        self.arrays = hasattr(PredictTouch.Request(), "contacts")

    def wait(self) -> None:
        if not self._client.wait_for_service(TIMEOUT_S):
            raise SystemExit("predict_touch: no such service")

    def request(self, count: int, *, oriented: bool) -> Any:
        """A request, by arrays where the version has them."""
        request = self._kind.Request(cloud=self._cloud, table=[] if oriented else [self._table])
        contacts = self._contacts[:count]
        turned = rotations(contacts)
        if self.arrays:
            request.contacts = contacts.ravel()
            request.rotations = turned.ravel() if oriented else []
            return request
        from foretouch_msgs.msg import Grasp

        for pair, rotation in zip(contacts.tolist(), turned, strict=True):
            grasp = Grasp(rotation=rotation.ravel() if oriented else np.zeros(9))
            grasp.pose.orientation.w = 0.0
            grasp.g1.x, grasp.g1.y, grasp.g1.z, grasp.g2.x, grasp.g2.y, grasp.g2.z = pair
            request.grasps.append(grasp)
        return request

    def ask(self, count: int, *, oriented: bool) -> dict[str, Any]:
        """Time of the round trip [ms], and the predictions as float32."""
        request = self.request(count, oriented=oriented)
        began = time.perf_counter()
        future = self._client.call_async(request)
        self._rclpy.spin_until_future_complete(self._node, future, timeout_sec=TIMEOUT_S)
        took = 1e3 * (time.perf_counter() - began)
        if not future.done():
            raise SystemExit(f"predict_touch: no answer within {TIMEOUT_S:g} s")
        return {"ms": took, "values": self._values(future.result()).tolist()}

    def _values(self, response: Any) -> Any:
        if self.arrays:
            batch = response.batch
            parts = [np.reshape(part, (len(batch.statuses), -1)) for part in (batch.scalars, batch.values)]
            return np.concatenate(parts, axis=1)
        rows = [(one.pdc_th, one.pdc_mf, *one.e_th, *one.e_mf) for one in response.touch.predictions]
        return np.array([[each.value for each in row] for row in rows])


def serve() -> int:
    """Answer lines of the standard input until it ends."""
    requests = _Requests()
    requests.wait()
    for line in sys.stdin:
        count, oriented = line.split()
        print(json.dumps(requests.ask(int(count), oriented=oriented == "True")), flush=True)
    return 0


class _Version:
    """The graph and the client of one checkout, while the context is open."""

    def __init__(self, root: Path, domain: int, stack: ExitStack) -> None:
        python = root / ".venv/bin/python"
        kept = {
            name: os.environ[name] for name in ("PATH", "HOME") if name in os.environ
        }  # nothing of this environment
        environment = kept | {"ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
        code = "import sys; from foretouch.ros.executables import run; n = sys.argv.index('--ros-args'); "
        code += "sys.exit(run(*sys.argv[1:n], args=[sys.argv[0], *sys.argv[n:]]))"
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "cwd": root, "env": environment}
        graph = subprocess.Popen([python, "-c", code, *NODES, "--ros-args"], **quiet)
        stack.callback(graph.wait, 30.0)
        stack.callback(graph.terminate)
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True, "cwd": root, "env": environment}
        self._client = subprocess.Popen([python, Path(__file__).resolve()], **pipes)
        stack.callback(self._client.wait, 30.0)
        stack.callback(self._client.stdin.close)

    def ask(self, count: int, *, oriented: bool) -> dict[str, Any]:
        self._client.stdin.write(f"{count} {oriented}\n")
        self._client.stdin.flush()
        line = self._client.stdout.readline()
        if not line:
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
                for number in range(rounds + 1):
                    found = {name: one.ask(count, oriented=oriented) for name, one in versions.items()}
                    if oriented and found["old"]["values"] != found["new"]["values"]:
                        raise SystemExit(f"{count} grasps: the predictions of both versions differ")
                    if number:  # the first warms up
                        for name in versions:
                            times[name].append(found[name]["ms"])
                least = {name: min(taken) for name, taken in times.items()}
                middle = {name: float(np.median(taken)) for name, taken in times.items()}
                rows.append({
                    "grasps": count,
                    "orientations": "given" if oriented else "computed",
                    **{f"{name}_best_ms": f"{least[name]:.3g}" for name in versions},
                    **{f"{name}_median_ms": f"{middle[name]:.3g}" for name in versions},
                    "best_ratio": f"{least['new'] / least['old']:.3f}",
                    "median_ratio": f"{middle['new'] / middle['old']:.3f}",
                })  # fmt: skip
                print(rows[-1], flush=True)
    return rows


if __name__ == "__main__":
    sys.exit(serve())
