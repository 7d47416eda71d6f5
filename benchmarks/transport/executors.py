# SPDX-License-Identifier: Apache-2.0
"""Processor time and age of received messages under our executor and two of rclpy, and whether each survives publishers beside it.

`python -m benchmarks.transport.executors` (see README.md). Each row is the best of `--turns` turns, in which the executors take turns.
"""

import argparse
import os
import subprocess
import sys
import threading
import time
from collections import defaultdict
from typing import Any, Final

import numpy as np

from benchmarks.common import ROOT, OthersLoad, print_rows
from benchmarks.ros import prepare_domain, stamp_ns, stamped

DOMAIN: Final = 89
EXECUTORS: Final = ("GraphExecutor", "EventsExecutor", "SingleThreadedExecutor")
REST_S: Final = 2.0  # without messages
BESIDE: Final = 2000  # messages that another thread of the same process publishes, 500 a second
MESSAGES: Final = (("cloud", 30.0), ("cloud", 60.0), ("cloud", 90.0), ("table", 100.0))


def made(kind: str) -> Any:
    """A cloud of 848x480, or a table."""
    from foretouch.ros.messages.clouds import cloud_to_msg
    from foretouch.types import Cloud
    from foretouch_msgs.msg import TablePlane

    if kind == "table":
        return TablePlane()
    return cloud_to_msg(Cloud(np.random.default_rng(0).random((480, 848, 3), np.float32), None, "cam"))


def send(publisher: Any, message: Any, rate_hz: float, count: int) -> None:
    """Publish at a rate."""
    begin = time.monotonic()
    for number in range(count):
        time.sleep(max(0.0, begin + number / rate_hz - time.monotonic()))
        stamped(message)
        publisher.publish(message)


def executor_of(name: str) -> Any:
    """An executor by name."""
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.experimental import EventsExecutor

    from foretouch.ros.runtime.executor import GraphExecutor
    from foretouch.ros.runtime.internal_errors import InternalErrors

    made_by = {"EventsExecutor": EventsExecutor, "SingleThreadedExecutor": SingleThreadedExecutor}
    return made_by[name]() if name in made_by else GraphExecutor(InternalErrors(print))


def spin(executor: Any) -> None:
    """As nodes do; `EventsExecutor.spin` calls back with nothing at all (rclpy 7.1.6 and 9.1.2)."""
    while True:
        executor.spin_once(timeout_sec=0.5)


def receive(name: str, kind: str, rate_hz: float, count: int, *, beside: bool) -> None:
    """In a process of its own: receive, and print received, p50, p95 [ms] and CPU a message [ms]."""
    import rclpy
    from rclpy.qos import QoSProfile, ReliabilityPolicy

    from foretouch.ros.runtime.executor import InputGroup

    rclpy.init()
    node, message, ages = rclpy.create_node("receiver"), made(kind), []

    def hear(content: Any, *_: Any) -> None:  # `EventsExecutor` raises a SystemError where the information is asked for
        ages.append((time.time_ns() - stamp_ns(content.header.stamp)) / 1e6)

    profile = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)
    node.create_subscription(type(message), "x", hear, profile, callback_group=InputGroup())
    executor = executor_of(name)
    executor.add_node(node)
    threading.Thread(target=spin, args=(executor,), daemon=True).start()
    if beside:
        send(node.create_publisher(type(message), "x", 10), message, rate_hz, count)
        time.sleep(0.5)
        print(len(ages), flush=True)
        os._exit(0)
    command = [sys.executable, "-m", "benchmarks.transport.executors", "--send", kind, str(rate_hz), str(count)]
    sender = subprocess.Popen(command, cwd=ROOT)
    while len(ages) < 3:
        time.sleep(0.01)
    began, first = time.process_time(), len(ages)
    sender.wait()
    used, last, rest = time.process_time() - began, len(ages), time.process_time()
    time.sleep(REST_S)
    rest = (time.process_time() - rest) / REST_S
    cpu_ms = 1e3 * (used - rest * (last - first) / rate_hz) / (last - first)
    print(last, *np.percentile(ages, (50, 95)), cpu_ms, flush=True)
    os._exit(0)  # EventsExecutor does not always end


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=6.0, help="length of each run [s]")
    parser.add_argument("--turns", type=int, default=3)
    parser.add_argument("--send", nargs=3, metavar=("KIND", "HZ", "COUNT"), help=argparse.SUPPRESS)
    parser.add_argument("--receive", nargs=5, metavar="...", help=argparse.SUPPRESS)
    options = parser.parse_args()
    prepare_domain(DOMAIN)
    if options.receive:
        name, kind, rate, count, beside = options.receive
        receive(name, kind, float(rate), int(count), beside=beside == "beside")
    if options.send:
        send_to_one(options.send[0], float(options.send[1]), int(options.send[2]))
        return 0
    others, found = OthersLoad(), defaultdict(list)
    for _ in range(options.turns):
        for kind, rate in MESSAGES:
            for name in EXECUTORS:
                found[kind, rate, name].append(run(name, kind, rate, round(rate * options.seconds)))
    rows = []
    for (kind, rate, name), results in found.items():
        received, *times = np.array([one for one in results if one] or [[0.0] * 4]).T
        p50, p95, cpu = (f"{min(values):.3g}" for values in times)
        sent = round(rate * options.seconds)
        rows.append({"executor": name, "message": kind, "Hz": f"{rate:g}", "received": f"{max(received):.0f} of {sent}",
                     "p50_ms": p50, "p95_ms": p95, "cpu_ms": cpu})  # fmt: skip
    for name in EXECUTORS:
        (count,) = run(name, "table", 500.0, BESIDE, beside="beside") or (0.0,)
        rows.append({"executor": name, "message": "table, from another thread", "Hz": "500", "received":
                     f"{count:.0f} of {BESIDE}" if count else "stopped for good", "p50_ms": "", "p95_ms": "", "cpu_ms": ""})  # fmt: skip
    print_rows(rows)
    print(f"cores used by others: {others.cores():.2f}")
    return 0


def send_to_one(kind: str, rate_hz: float, count: int) -> None:
    """In a process of its own: publish once there is a subscriber."""
    import rclpy

    rclpy.init()
    node, message = rclpy.create_node("sender"), made(kind)
    publisher = node.create_publisher(type(message), "x", 10)
    while not publisher.get_subscription_count():
        time.sleep(0.01)
    time.sleep(0.5)
    send(publisher, message, rate_hz, count)
    time.sleep(0.3)


def run(name: str, kind: str, rate_hz: float, count: int, beside: str = "") -> list[float]:
    """What `receive` prints in a process of its own; empty if that hangs."""
    command = [
        sys.executable,
        "-m",
        "benchmarks.transport.executors",
        "--receive",
        name,
        kind,
        str(rate_hz),
        str(count),
        beside,
    ]
    child = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True)
    try:
        text, _ = child.communicate(timeout=count / rate_hz + 30.0)
    except subprocess.TimeoutExpired:
        child.kill()  # nothing else ends it
        child.wait()
        return []
    return [float(word) for word in text.split()]


if __name__ == "__main__":
    sys.exit(main())
