# SPDX-License-Identifier: Apache-2.0
"""Round trips of `predict_touch` beside a graph, of this version and of another checkout in turns (see README.md).

This file is also the client of either version: as a program of its environment, in a ROS domain of its own, it starts the graph and
answers each line `COUNT FORM ORIENTED` with a line of JSON.
"""

import json
import os
import subprocess
import sys
import time
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

COUNTS = (1, 10, 100, 1000)
FORMS = ("arrays", "messages")  # of the grasps in a request, and of the predictions in its answer
TIMEOUT_S = 120.0
RADIUS_M, AWAY_M = 0.03, 0.8  # of the object, a standing cylinder, and from the camera to it
HAND = ((0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (-1.0, 0.0, 0.0))  # its z from the second contact to the first
_START = (
    "import sys; from foretouch.ros.executables import run; import foretouch; "
    "one = ['touch_predictor'] if foretouch.__version__ == '0.3.0' else ['perception', '--ros-args', '-p', 'input:=points']; "
    "sys.exit(run(one[0], args=[sys.argv[0], *one[1:]]))"  # 0.3 predicts in a node of its own
)


def requests(points: int = 3000) -> Any:
    """Return a function from (count, form, oriented) to a request: as many grasps at any height of the cylinder, of which one half is seen."""
    from sensor_msgs.msg import PointCloud2, PointField
    from shape_msgs.msg import Plane

    from foretouch_msgs.msg import Grasp
    from foretouch_msgs.srv import PredictTouch

    rng = np.random.default_rng(0)
    angle, height = rng.uniform((0.0, -0.06), (np.pi, 0.06), (points, 2)).T
    xyz = np.column_stack([RADIUS_M * np.cos(angle), height, AWAY_M - RADIUS_M * np.sin(angle)]).astype(np.float32)
    contacts = np.tile([RADIUS_M, 0.0, AWAY_M, -RADIUS_M, 0.0, AWAY_M], (max(COUNTS), 1))
    contacts[:, [1, 4]] = rng.uniform(-0.05, 0.05, (max(COUNTS), 1))
    fields = [PointField(name=name, offset=4 * k, datatype=7, count=1) for k, name in enumerate("xyz")]
    cloud = PointCloud2(height=1, width=points, fields=fields, point_step=12, row_step=12 * points, data=xyz.tobytes())
    cloud.header.frame_id = "camera_depth_optical_frame"
    table = Plane(coef=[0.0, -1.0, 0.0, 0.06])  # below the cylinder; y points down

    def message(contact: npt.NDArray[np.float64], oriented: bool) -> Any:
        grasp = Grasp()
        for point, xyz in ((grasp.g1, contact[:3]), (grasp.g2, contact[3:])):
            point.x, point.y, point.z = map(float, xyz)
        if oriented:
            q = grasp.pose.orientation
            q.x, q.y, q.z, q.w = map(float, Rotation.from_matrix(HAND).as_quat())
        return grasp

    def made(count: int, form: str, oriented: bool) -> Any:
        request = PredictTouch.Request(cloud=cloud, table=[] if oriented else [table])
        if form == "messages":
            request.grasps = [message(contact, oriented) for contact in contacts[:count]]
        else:
            request.contacts = contacts[:count].ravel()
            request.rotations = np.tile(np.ravel(HAND), count if oriented else 0)
        return request

    return made


def serve() -> None:
    """Answer lines of the standard input until it ends: the time of a round trip [ms], and the predictions as float32."""
    graph = subprocess.Popen([sys.executable, "-c", _START], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        from foretouch.ros.runtime.environment import prepare_environment

        prepare_environment()
        import rclpy

        from foretouch_msgs.srv import PredictTouch

        rclpy.init()
        node, request_of = rclpy.create_node("round_trip", namespace="/foretouch"), requests()
        client = node.create_client(PredictTouch, "predict_touch")
        if not client.wait_for_service(TIMEOUT_S):
            raise SystemExit("predict_touch: no such service")
        for line in sys.stdin:
            count, form, oriented = line.split()
            request, began = request_of(int(count), form, oriented == "True"), time.perf_counter()
            future = client.call_async(request)
            rclpy.spin_until_future_complete(node, future, timeout_sec=TIMEOUT_S)
            took = 1e3 * (time.perf_counter() - began)
            if not future.done():
                raise SystemExit(f"predict_touch: no answer within {TIMEOUT_S:g} s")
            answer = future.result()
            predictions = answer.touch.predictions if form == "messages" else [answer.batch]
            values = [float(value) for one in predictions for value in (*one.scalars, *one.values)]
            print(json.dumps({"ms": took, "values": values}), flush=True)
    finally:
        graph.terminate()
        graph.wait(30.0)


def _client(root: Path, domain: int) -> "subprocess.Popen[str]":
    kept = {name: os.environ[name] for name in ("PATH", "HOME") if name in os.environ}  # nothing of this environment
    own = kept | {"ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    command, pipe = [root / ".venv/bin/python", Path(__file__).resolve()], subprocess.PIPE
    return subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True, cwd=root, env=own)


def _ask(client: "subprocess.Popen[str]", count: int, form: str, oriented: bool) -> dict[str, Any]:
    assert client.stdin is not None
    assert client.stdout is not None
    client.stdin.write(f"{count} {form} {oriented}\n")
    client.stdin.flush()
    if not (line := client.stdout.readline()):
        raise SystemExit("a client of the round trips ended")
    answer: dict[str, Any] = json.loads(line)
    return answer


def compare(old: Path, new: Path, domain: int, rounds: int = 20) -> list[dict[str, Any]]:
    """Return rows of the least and the median round trip of both checkouts by the number of grasps, asked in turns.

    `equal` says whether all predictions were equal to the last bit of a float32.
    """
    rows = []
    with _client(old, domain) as before, _client(new, domain + 1) as now:
        for form, oriented, count in product(FORMS, (True, False), COUNTS):
            answers = [[_ask(client, count, form, oriented) for client in (before, now)] for _ in range(rounds + 1)]
            ms = np.array([[answer["ms"] for answer in pair] for pair in answers[1:]])  # the first warms up
            row: dict[str, Any] = {"grasps": count, "form": form, "orientations": "given" if oriented else "computed"}
            for what, (old_ms, new_ms) in (("best", ms.min(axis=0)), ("median", np.median(ms, axis=0))):
                row |= {f"old_{what}_ms": f"{old_ms:.3g}", f"new_{what}_ms": f"{new_ms:.3g}"}
                row[f"{what}_ratio"] = f"{new_ms / old_ms:.3f}"
            row["equal"] = all(earlier["values"] == later["values"] for earlier, later in answers)
            rows.append(row)
            print(row, flush=True)
    return rows


if __name__ == "__main__":
    serve()
