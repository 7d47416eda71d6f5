# SPDX-License-Identifier: Apache-2.0
"""Processor time of an answer with and without subscribers of the standard messages, in turns in one process (see README.md)."""

import argparse
import time
from pathlib import Path
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseArray
from sensor_msgs.msg import Image

from benchmarks.ros import end, spawn
from benchmarks.transport.bench import NOW, Bench, Condition, scenes
from foretouch.errors import MissingDependencyError
from foretouch.ros.messages.clouds import depth_to_msgs
from foretouch.ros.messages.tactile import message_class

TOPICS: dict[str, type] = {"grasp_poses": PoseArray, "labels": Image, "overlay": Image}
try:
    TOPICS["detections"] = message_class("vision_msgs/Detection3DArray")
except MissingDependencyError as err:
    print(f"without detections: {err}")


def cpu_s(pid: int) -> float:
    """Return the processor time of all threads of a process so far [s], to the nanosecond."""
    stats = Path(f"/proc/{pid}/task").glob("*/schedstat")
    return sum(int(stat.read_text(encoding="utf-8").split()[0]) for stat in stats) * 1e-9


def burst(bench: Bench, pid: int, inputs: list[Any], count: int) -> float:
    """Send images one after the other, each after the answer to the last; returns the processor time of an answer [s]."""
    before = cpu_s(pid)
    for number in range(count):
        stamp = bench.send(inputs[number % len(inputs)])
        if not bench.wait(lambda stamp=stamp: stamp in bench.answers, 20.0):
            raise SystemExit("an image was not answered")
    time.sleep(0.05)  # images and markers come after the answer
    return (cpu_s(pid) - before) / count


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--turns", type=int, default=40)
    turns = parser.parse_args().turns
    bench = Bench(Condition("now", "depth", "profile"))
    wanted = {f"publish_{topic}": True for topic in TOPICS if topic != "grasp_poses"}
    graph = spawn(NOW, {"diagnostics_period_s": 0.5, **wanted})
    inputs = [depth_to_msgs(frame)[::-1] for frame in scenes()]
    costs: dict[bool, list[float]] = {False: [], True: []}
    try:
        bench.ready()
        burst(bench, graph.pid, inputs, 20)
        for _ in range(turns):
            costs[False].append(burst(bench, graph.pid, inputs, 10))
            subscriptions = [
                bench.node.create_subscription(kind, topic, lambda _: None, 10) for topic, kind in TOPICS.items()
            ]
            bench.wait(lambda subscriptions=subscriptions: all(s.get_publisher_count() for s in subscriptions), 10.0)
            burst(bench, graph.pid, inputs, 2)
            costs[True].append(burst(bench, graph.pid, inputs, 10))
            for subscription in subscriptions:
                bench.node.destroy_subscription(subscription)
            time.sleep(0.1)
    finally:
        end(graph)
        bench.leave()
    off, on = (1e3 * float(np.median(costs[each])) for each in (False, True))
    print(f"{', '.join(TOPICS)}: {off:.2f} ms without, {on:.2f} ms with subscribers: {on / off:.3f}")


if __name__ == "__main__":
    main()
