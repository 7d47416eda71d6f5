# SPDX-License-Identifier: Apache-2.0
"""The live graph at 30 Hz with the bridge and a client that reads: losses and processor time (see README.md)."""

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
from collections.abc import Callable
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
PORT, DOMAIN = 18765, 88
ALL = ("points", "object_cloud", "objects", "table", "grasps", "touch", "markers")
TOPICS = {"all": ALL, "all but points": ALL[1:]}  # what the client reads
TICKS = os.sysconf("SC_CLK_TCK")
SETTLED_S = 3.0


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=20.0, help="length of each run [s]")
    parser.add_argument("--rate", type=float, default=30.0, help="clouds a second [Hz]")
    parser.add_argument("--repeat", type=int, default=3, help="runs of each kind")
    parser.add_argument("--out", type=Path, default=HERE / "results")
    parser.add_argument("--client", choices=TOPICS, help=argparse.SUPPRESS)  # the process that reads
    return parser.parse_args()


def client(what: str) -> None:
    """Read topics until the server closes, and print what came."""
    sys.path.insert(0, str(ROOT / "test"))
    from websocket_client import WebSocketClient

    counts: Counter[str] = Counter()
    size = 0
    with WebSocketClient(f"ws://127.0.0.1:{PORT}") as reader:
        reader.subscribe(*(f"/foretouch/{topic}" for topic in TOPICS[what]))
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


def start(*names: str, port: int = PORT) -> subprocess.Popen[bytes]:
    """Nodes in a process of their own."""
    code = f"import sys; from foretouch.ros.executables import run; sys.exit(run(*{names!r}))"
    return subprocess.Popen(
        [sys.executable, "-c", code, "--ros-args", "-p", f"port:={port}"], stderr=subprocess.DEVNULL
    )


def run(options: argparse.Namespace, messages: list[Any], reads: str) -> dict[str, Any]:
    """One run: the graph, the bridge and the client in a process each, the camera and a plain subscriber here."""
    import rclpy
    from diagnostic_msgs.msg import DiagnosticArray
    from rclpy.node import Node
    from rclpy.qos import QoSProfile, ReliabilityPolicy
    from sensor_msgs.msg import PointCloud2

    from foretouch.ros.messages.conversions import stamp_to_msg
    from foretouch.ros.runtime.executor import GraphExecutor
    from foretouch.ros.runtime.internal_errors import InternalErrors
    from foretouch_msgs.msg import TouchPredictionArray

    topics = TOPICS[reads]
    graph, bridge = start("segmentation", "grasp", "touch_predictor"), start("bridge")
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
    publisher = node.create_publisher(PointCloud2, "points", 10)  # as our camera node does
    executor = GraphExecutor(InternalErrors(print))
    executor.add_node(node)
    threading.Thread(target=executor.spin, daemon=True).start()
    while (
        "url" not in values or publisher.get_subscription_count() < 1 or node.count_publishers("/foretouch/touch") < 1
    ):
        time.sleep(0.1)
    reader = subprocess.Popen([sys.executable, __file__, "--client", reads], stdout=subprocess.PIPE, text=True)
    assert reader.stdout is not None
    reader.stdout.readline()
    while len(values.get("topics", "").split()) < len(topics):
        time.sleep(0.1)
    time.sleep(SETTLED_S)
    before, began = cpu_s(bridge.pid), time.monotonic()
    count = round(options.seconds * options.rate)
    for k in range(count):
        message = messages[k % len(messages)]
        message.header.stamp = stamp_to_msg(time.time_ns())
        publisher.publish(message)
        time.sleep(max(0.0, began + (k + 1) / options.rate - time.monotonic()))
    wall_s = time.monotonic() - began
    wait_until_stable(lambda: (values.get("received"), len(answers)))
    used_s, answered = cpu_s(bridge.pid) - before, len(answers)
    for process in (bridge, graph):
        process.send_signal(signal.SIGINT)
        process.wait(30)
    executor.shutdown(1.0)
    rclpy.shutdown()
    found = json.loads(reader.communicate(timeout=20)[0].strip().splitlines()[-1])
    return {
        "reads": reads,
        "sent": count,
        "rate_hz": round(count / wall_s, 1),
        "answered": answered,
        **{f"client_{topic}": found["counts"].get(topic, 0) for topic in ALL},
        "mb_per_s": round(found["bytes"] / 1e6 / wall_s, 1),
        "lost_before_the_bridge": int(values["lost_on_the_way"]),
        "lost_in_the_bridge": int(values["received"]) - sum(found["counts"].values()),
        "slow_clients": int(values["slow_clients"]),
        "bridge_cpu_percent": round(100.0 * used_s / wall_s, 1),
        "bridge_cpu_ms_a_cloud": round(1e3 * used_s / count, 2),
    }


def wait_until_stable(state: Callable[[], Any]) -> None:
    """Wait until nothing has changed for longer than the period of /diagnostics."""
    last, since = state(), time.monotonic()
    while time.monotonic() - since < SETTLED_S:
        time.sleep(0.1)
        if state() != last:
            last, since = state(), time.monotonic()


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
        client(options.client)
        return 0
    os.environ |= {"ROS_DOMAIN_ID": str(DOMAIN), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    from foretouch.ros.runtime.environment import prepare_environment

    prepare_environment()
    messages = clouds()
    rows = []
    for _ in range(options.repeat):
        for reads in TOPICS:
            rows.append(run(options, messages, reads))
            print(rows[-1], flush=True)
    options.out.mkdir(parents=True, exist_ok=True)
    with (options.out / "runs.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    print(f"{platform.machine()}, {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}")
    for reads in TOPICS:
        own = [row for row in rows if row["reads"] == reads]
        cpu = statistics.median(row["bridge_cpu_percent"] for row in own)
        lost = sum(row["answered"] - row["client_touch"] for row in own), sum(row["lost_in_the_bridge"] for row in own)
        each = statistics.median(row["bridge_cpu_ms_a_cloud"] for row in own)
        print(
            f"{reads}: {lost[0]} answers not received, {lost[1]} messages lost in the bridge, "
            f"{cpu:.1f} % of a core, {each:.1f} ms a cloud"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
