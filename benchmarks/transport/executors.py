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

    cloud = np.random.default_rng(0).random((480, 848, 3), np.float32)
    return TablePlane() if kind == "table" else cloud_to_msg(Cloud(cloud, None, "cam"))


def send(node: Any, message: Any, rate_hz: float, count: int) -> None:
    """Publish at a rate once there is a subscriber."""
    publisher = node.create_publisher(type(message), "x", 10)
    while not publisher.get_subscription_count():
        time.sleep(0.01)
    time.sleep(0.5)
    begin = time.monotonic()
    for number in range(count):
        time.sleep(max(0.0, begin + number / rate_hz - time.monotonic()))
        stamped(message)
        publisher.publish(message)
    time.sleep(0.5)


def receive(name: str, kind: str, rate_hz: float, count: int, *, beside: bool) -> None:
    """In a process of its own: receive from another or beside a publisher, and print received, p50, p95 and CPU a message [ms]."""
    import rclpy
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.experimental import EventsExecutor
    from rclpy.qos import QoSProfile, ReliabilityPolicy

    from foretouch.ros.runtime.executor import GraphExecutor, InputGroup
    from foretouch.ros.runtime.internal_errors import InternalErrors

    rclpy.init()
    node, message, ages = rclpy.create_node("receiver"), made(kind), []

    def hear(content: Any, *_: Any) -> None:  # `EventsExecutor` raises a SystemError where the information is asked for
        ages.append((time.time_ns() - stamp_ns(content.header.stamp)) / 1e6)

    def spin() -> None:  # as nodes do; `EventsExecutor.spin` calls back with nothing at all (rclpy 7.1.6 and 9.1.2)
        while True:
            executor.spin_once(timeout_sec=0.5)

    profile = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)
    node.create_subscription(type(message), "x", hear, profile, callback_group=InputGroup())
    made_by = {"EventsExecutor": EventsExecutor, "SingleThreadedExecutor": SingleThreadedExecutor}
    executor = made_by[name]() if name in made_by else GraphExecutor(InternalErrors(print))
    executor.add_node(node)
    threading.Thread(target=spin, daemon=True).start()
    if beside:
        send(node, message, rate_hz, count)
        print(len(ages), flush=True)
        os._exit(0)
    sender = subprocess.Popen(_command("send", "-", kind, rate_hz, count), cwd=ROOT)
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


def run(name: str, kind: str, rate_hz: float, count: int, what: str = "receive") -> list[float]:
    """What `receive` prints in a process of its own; empty if that hangs."""
    child = subprocess.Popen(_command(what, name, kind, rate_hz, count), cwd=ROOT, stdout=subprocess.PIPE, text=True)
    try:
        text, _ = child.communicate(timeout=count / rate_hz + 30.0)
    except subprocess.TimeoutExpired:
        child.kill()  # nothing else ends it
        child.wait()
        return []
    return [float(word) for word in text.split()]


def _command(*words: Any) -> list[str]:
    return [sys.executable, "-m", "benchmarks.transport.executors", "--as", *map(str, words)]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=6.0, help="length of each run [s]")
    parser.add_argument("--turns", type=int, default=3)
    parser.add_argument("--as", nargs=5, dest="part", help=argparse.SUPPRESS)
    options = parser.parse_args()
    prepare_domain(DOMAIN)
    if options.part:
        what, name, kind, rate, count = options.part
        if what != "send":
            receive(name, kind, float(rate), int(count), beside=what == "beside")
        import rclpy

        rclpy.init()
        send(rclpy.create_node("sender"), made(kind), float(rate), int(count))
        return 0
    others, found = OthersLoad(), defaultdict(list)
    for _ in range(options.turns):
        for kind, rate in MESSAGES:
            for name in EXECUTORS:
                found[kind, rate, name].append(run(name, kind, rate, round(rate * options.seconds)))
    rows = []
    for (kind, rate, name), results in found.items():
        received, *times = np.array([one for one in results if one] or [[0.0] * 4]).T
        columns = dict(zip(("p50_ms", "p95_ms", "cpu_ms"), (f"{min(values):.3g}" for values in times), strict=True))
        of = f"{max(received):.0f} of {rate * options.seconds:.0f}"
        rows.append({"executor": name, "message": kind, "Hz": f"{rate:g}", "received": of, **columns})
    print_rows(rows)
    for name in EXECUTORS:
        (count,) = run(name, "table", 500.0, BESIDE, "beside") or (0.0,)
        print(f"{name}: {count:.0f} of {BESIDE} from another thread" if count else f"{name}: stopped for good")
    print(f"cores used by others: {others.cores():.2f}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
