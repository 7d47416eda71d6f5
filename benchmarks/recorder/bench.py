# SPDX-License-Identifier: Apache-2.0
"""Does the recorder keep up, and does it leave room for the rest? See README.md."""

from __future__ import annotations

import argparse
import multiprocessing as mp
import os
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

DOMAIN = 83
FRAME = "camera_depth_optical_frame"
OBJECT_POINTS = 5000
GRASP_S = 3.0
FILLING_S = 65.0  # the recorder keeps the clouds of the last minute
SECOND = 1_000_000_000
REST = np.concatenate([[2779], [1676], np.full(48, 3200)]).astype(np.int16)


def send(seconds: float, raw_hz: float, ready: Any) -> None:
    """Another process: a camera, a planner and a hand, each message at its time."""
    node = _node("bench_sender")
    senders = _senders(node, raw=raw_hz > 0)
    ready.wait()
    while not all(
        sender.get_subscription_count()
        for sender in node.publishers
        if not sender.topic_name.endswith(("rosout", "parameter_events"))
    ):
        time.sleep(0.05)  # what is sent before the recorder is found is none of its losses
    begin, begin_ns = time.monotonic() + 0.5, time.time_ns() + SECOND // 2
    events = sorted(
        [(k / 100.0, "hand", k) for k in range(round(seconds * 100))]
        + [(k / 30.0, "cloud", k) for k in range(round(seconds * 30))]
        + [(k / raw_hz, "raw", k) for k in range(round(seconds * raw_hz))]
        + [(k * GRASP_S + 2.5, "told", k) for k in range(int(seconds / GRASP_S))]
    )
    for due, kind, number in events:
        time.sleep(max(0.0, begin + due - time.monotonic()))
        senders[kind](number, begin_ns + round(due * SECOND))
    time.sleep(3.0)


def _node(name: str) -> Any:
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    from foretouch.ros.runtime.environment import prepare_environment

    prepare_environment()
    import rclpy
    from rclpy.node import Node

    rclpy.init(domain_id=DOMAIN)
    return Node(name, namespace="/foretouch")


def _senders(node: Any, *, raw: bool) -> dict[str, Any]:
    from sensor_msgs.msg import PointCloud2

    from foretouch.pipeline import FoundObject
    from foretouch.ros.messages.clouds import cloud_to_msg, objects_to_msg
    from foretouch.ros.messages.conversions import grasp_to_msg, header_to_msg, stamp_to_msg
    from foretouch.ros.messages.tactile import biotac_all_to_msg
    from foretouch.types import ASSUMED_TABLE, Cloud, Grasp
    from foretouch_msgs.msg import BiotacAll, ExecutedGrasp, GraspArray

    rng = np.random.default_rng(0)
    xyz = rng.normal(size=(OBJECT_POINTS, 3)).astype(np.float32)
    rgb = rng.integers(0, 255, (OBJECT_POINTS, 3)).astype(np.uint8)
    target = FoundObject("1", Cloud(xyz, rgb, FRAME), ASSUMED_TABLE)
    grasp = Grasp(np.array([0.0, 0.03, 0.5]), np.array([0.0, -0.03, 0.5]), np.eye(3), 1.0, "", "1")
    clouds = node.create_publisher(PointCloud2, "object_cloud", 10)
    scenes = node.create_publisher(PointCloud2, "points", 10) if raw else None
    grasps, hand = node.create_publisher(GraspArray, "grasps", 10), node.create_publisher(BiotacAll, "/rh/tactile", 100)
    told = node.create_publisher(ExecutedGrasp, "executed_grasp", 10)
    image = rng.normal(size=(480, 848, 3)).astype(np.float32)
    scene = cloud_to_msg(Cloud(image, np.zeros((480, 848, 3), np.uint8), FRAME))
    cloud_message, grasp_message = objects_to_msg([target], FRAME, 0), grasp_to_msg(grasp)
    stamps: dict[int, int] = {}

    def feel(number: int, stamp: int) -> None:
        held = 100 <= number % 300 < 200  # the second second of every three
        counts = REST + np.where(held, np.r_[150, 150, np.full(48, -80)], 0)
        noisy = np.round(counts + rng.normal(0, 1, 50) * np.r_[0.3, 0.3, np.full(48, 4.0)]).astype(np.int16)
        fingers = {"TH": np.r_[noisy[0], noisy[2:26]], "MF": np.r_[noisy[1], noisy[26:]]}
        hand.publish(biotac_all_to_msg(fingers, "rh", stamp))

    def see(number: int, stamp: int) -> None:
        stamps[number] = stamp
        cloud_message.header = header_to_msg(FRAME, stamp)
        clouds.publish(cloud_message)
        grasp_message.id = f"g-{number}"
        grasps.publish(GraspArray(header=cloud_message.header, grasps=[grasp_message]))

    def look(_number: int, stamp: int) -> None:
        scene.header = header_to_msg(FRAME, stamp)
        if scenes is not None:
            scenes.publish(scene)

    def tell(_number: int, stamp: int) -> None:
        begin = stamp - round(2.5 * SECOND)
        planned = f"g-{max(k for k in stamps if stamps[k] < begin + SECOND // 2)}"
        times = {"start": 0.9, "contact": 1.0, "release": 2.0}
        ends = {name: stamp_to_msg(begin + round(at * SECOND)) for name, at in times.items()}
        told.publish(ExecutedGrasp(header=header_to_msg(FRAME, stamp), grasp_id=planned, success=True, **ends))

    return {"hand": feel, "cloud": see, "raw": look, "told": tell}


def memory_mb() -> float:
    """What this process holds of the machine's memory."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def record(folder: Path, seconds: float, raw_hz: float, ready: Any) -> dict[str, Any]:
    """The recorder in this process, as `foretouch record` runs it."""
    os.environ |= {"ROS_DOMAIN_ID": str(DOMAIN), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    from foretouch.ros.graph import Graph
    from foretouch.ros.nodes.recorder import RecorderNode

    parameters = {"points": raw_hz > 0, "writing.min_free_mb": 2000.0}
    with Graph({"recorder": parameters}) as graph:
        node = graph.nodes["recorder"]
        assert isinstance(node, RecorderNode)
        node.begin(str(folder / "set"), "thing")
        ready.set()
        time.sleep(3.0)
        began, cpu, trace = time.monotonic(), time.process_time(), []
        while time.monotonic() - began < seconds:
            time.sleep(1.0)
            trace.append((time.monotonic() - began, memory_mb()))
        share = (time.process_time() - cpu) / (time.monotonic() - began)
        time.sleep(3.0)
        ended = time.monotonic()
        node.end()
        return {"status": node.status(), "cpu": share, "trace": trace, "close_s": time.monotonic() - ended}


def main() -> int:
    """Print one table; exit status 1 where a figure is missed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=1.0)
    parser.add_argument("--raw-hz", type=float, default=0.0, help="whole 848x480 clouds beside it")
    parser.add_argument("--folder", type=Path, help="where to record (default: a temporary folder)")
    arguments = parser.parse_args()
    seconds = 60.0 * arguments.minutes
    ready = mp.get_context("spawn").Event()
    sender = mp.get_context("spawn").Process(target=send, args=(seconds, arguments.raw_hz, ready))
    sender.start()
    with tempfile.TemporaryDirectory(dir=arguments.folder) as folder:
        result = record(Path(folder), seconds, arguments.raw_hz, ready)
        sender.join()
        return report(result, seconds, arguments.raw_hz)


def report(result: dict[str, Any], seconds: float, raw_hz: float) -> int:
    """Figures against what was sent."""
    status = result["status"]
    sent = {
        "/rh/tactile": round(seconds * 100),
        "/foretouch/object_cloud": round(seconds * 30),
        "/foretouch/grasps": round(seconds * 30),
        "/foretouch/executed_grasp": int(seconds / GRASP_S),
        **({"/foretouch/points": round(seconds * raw_hz)} if raw_hz else {}),
    }
    print(f"{'topic':28}{'sent':>8}{'received':>10}{'written':>9}{'dropped':>9}{'lost':>6}")
    missing = 0
    for topic in status.topics:
        if topic.topic in sent:
            dropped = sum(topic.drop_counts)
            missing += sent[topic.topic] - topic.written
            print(f"{topic.topic:28}{sent[topic.topic]:8}{topic.received:10}{topic.written:9}{dropped:9}{topic.lost:6}")
    filled = [pair for pair in result["trace"] if pair[0] > FILLING_S]
    slope = "not judged: the last minute of clouds is still being filled in"
    if len(filled) > FILLING_S / 4:
        times, sizes = np.array(filled).T
        slope = f"slope {np.polyfit(times, sizes, 1)[0] * 60.0:+.2f} MB/min"
    outcomes = dict(zip(status.outcomes, status.outcome_counts, strict=True))
    print(f"samples {status.samples} + {status.unlabelled} without touch; grasps {outcomes}")
    print(f"pairing error at most {1e3 * status.pairing_error_max:.0f} ms")
    print(f"CPU {100 * result['cpu']:.0f} % of one core; memory {result['trace'][-1][1]:.0f} MB, {slope}")
    print(f"{status.bytes_written / 1e6:.0f} MB, closed in {result['close_s']:.1f} s")
    return int(missing != 0 or result["cpu"] > 0.6)


if __name__ == "__main__":
    sys.exit(main())
