# SPDX-License-Identifier: Apache-2.0
"""The live graph at 30 Hz with the bridge and a client that reads all: losses and processor time (see README.md)."""

from __future__ import annotations

import argparse
import csv
import json
import os
import platform
import signal
import statistics
import subprocess
import sys
import threading
import time
from collections import Counter
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
PORT, DOMAIN = 18765, 88
TOPICS = ("points", "object_cloud", "objects", "table", "grasps", "touch", "markers")
TICKS = os.sysconf("SC_CLK_TCK")
SETTLED_S = 3.0


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=20.0, help="length of each run [s]")
    parser.add_argument("--rate", type=float, default=30.0, help="clouds a second [Hz]")
    parser.add_argument("--repeat", type=int, default=3, help="pairs of runs, with and without the bridge")
    parser.add_argument("--out", type=Path, default=HERE / "results")
    parser.add_argument("--client", action="store_true", help=argparse.SUPPRESS)  # the process that reads
    return parser.parse_args()


def client() -> None:
    """Read all topics until the server closes, and print what came."""
    sys.path.insert(0, str(ROOT / "test"))
    from websocket_client import WebSocketClient

    counts: Counter[str] = Counter()
    size = 0
    with WebSocketClient(f"ws://127.0.0.1:{PORT}") as reader:
        reader.subscribe(*(f"/foretouch/{topic}" for topic in TOPICS))
        print("subscribed", flush=True)
        try:
            while True:
                data = reader.next_data()
                counts[data.topic.rpartition("/")[2]] += 1
                size += len(data.content)
        except ConnectionError:
            print(json.dumps({"counts": counts, "bytes": size}))


def cpu_s(pid: int) -> float:
    """Processor time of a process [s]."""
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / TICKS


def run(options: argparse.Namespace, messages: list[Any], *, serve: bool) -> dict[str, Any]:
    """One run: graph (and bridge) in one process, the sender and a subscriber here, the client in a third."""
    import rclpy
    from diagnostic_msgs.msg import DiagnosticArray
    from rclpy.node import Node
    from rclpy.qos import QoSProfile, ReliabilityPolicy
    from sensor_msgs.msg import PointCloud2

    from foretouch.ros.messages.conversions import stamp_to_msg
    from foretouch.ros.runtime.executor import GraphExecutor
    from foretouch.ros.runtime.internal_errors import InternalErrors
    from foretouch_msgs.msg import TouchPredictionArray

    names = ("segmentation", "grasp", "touch_predictor", *["bridge"] * serve)
    code = f"import sys; from foretouch.ros.executables import run; sys.exit(run(*{names!r}))"
    graph = subprocess.Popen(
        [sys.executable, "-c", code, "--ros-args", "-p", f"port:={PORT}"], stderr=subprocess.DEVNULL
    )
    rclpy.init(domain_id=DOMAIN)
    node = Node("bench", namespace="/foretouch")
    answers: list[Any] = []
    values: dict[str, str] = {}

    def diagnosed(message: Any) -> None:
        for status in message.status:
            if status.name.endswith("bridge"):
                values.update({pair.key: pair.value for pair in status.values})

    reliable = QoSProfile(depth=1000, reliability=ReliabilityPolicy.RELIABLE)
    node.create_subscription(TouchPredictionArray, "touch", answers.append, reliable)
    node.create_subscription(DiagnosticArray, "/diagnostics", diagnosed, 10)
    best_effort = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)
    publisher = node.create_publisher(PointCloud2, "points", best_effort)
    executor = GraphExecutor(InternalErrors(print))
    executor.add_node(node)
    threading.Thread(target=executor.spin, daemon=True).start()
    reader = None
    try:
        while publisher.get_subscription_count() < 1 or node.count_publishers("/foretouch/touch") < 1:
            time.sleep(0.1)
        if serve:
            while "url" not in values:
                time.sleep(0.1)
            reader = subprocess.Popen([sys.executable, __file__, "--client"], stdout=subprocess.PIPE, text=True)
            assert reader.stdout is not None
            reader.stdout.readline()
            while publisher.get_subscription_count() < 2 or len(values.get("topics", "").split()) < len(TOPICS):
                time.sleep(0.1)
        time.sleep(SETTLED_S)
        before, began = cpu_s(graph.pid), time.monotonic()
        count = round(options.seconds * options.rate)
        for k in range(count):
            message = messages[k % len(messages)]
            message.header.stamp = stamp_to_msg(time.time_ns())
            publisher.publish(message)
            time.sleep(max(0.0, began + (k + 1) / options.rate - time.monotonic()))
        wall_s, used_s = time.monotonic() - began, cpu_s(graph.pid) - before
        time.sleep(SETTLED_S)
        row: dict[str, Any] = {"serve": serve, "sent": count, "answered": len(answers)}
        row |= {"cpu_percent": round(100.0 * used_s / wall_s, 1)}
    finally:
        graph.send_signal(signal.SIGINT)
        graph.wait(20)
        executor.shutdown(1.0)
        rclpy.shutdown()
    if reader is not None:
        found = json.loads(reader.communicate(timeout=20)[0].strip().splitlines()[-1])
        row |= {f"client_{topic}": found["counts"].get(topic, 0) for topic in TOPICS}
        row |= {"mb_per_s": round(found["bytes"] / 1e6 / options.seconds, 1)}
        row |= {
            "received": values["received"],
            "lost_on_the_way": values["lost_on_the_way"],
            "slow_clients": values["slow_clients"],
        }
    return row


def clouds() -> list[Any]:
    """Organised clouds of 848x480, as cameras send them."""
    import numpy as np

    from foretouch.ros.messages.clouds import cloud_to_msg
    from foretouch.simulation.depth_scene import random_scene

    rendered = (random_scene(np.random.default_rng(k), width=848, height=480, n_objects=3).render() for k in range(4))
    return [cloud_to_msg(one.cloud()) for one in rendered]


def main() -> int:
    options = arguments()
    if options.client:
        client()
        return 0
    os.environ |= {"ROS_DOMAIN_ID": str(DOMAIN), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    from foretouch.ros.runtime.environment import prepare_environment

    prepare_environment()
    messages = clouds()
    rows = []
    for _ in range(options.repeat):
        for serve in (False, True):
            rows.append(run(options, messages, serve=serve))
            print(rows[-1], flush=True)
    served = [row for row in rows if row["serve"]]
    more = [row["cpu_percent"] - alone["cpu_percent"] for alone, row in zip(rows[::2], served, strict=True)]
    lost = sum(max(0, row["answered"] - row["client_touch"]) for row in served)
    received = [row["client_points"] / row["sent"] for row in served]
    options.out.mkdir(parents=True, exist_ok=True)
    with (options.out / "runs.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(served[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    print(f"{platform.processor() or platform.machine()}, {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}")
    print(f"answers that the client did not get: {lost}; share of the clouds that it got: {min(received):.3f}")
    print(
        f"processor time more: {statistics.median(more):.1f} % of a core (each pair: {', '.join(f'{one:.1f}' for one in more)})"
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
