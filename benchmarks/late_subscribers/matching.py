# SPDX-License-Identifier: Apache-2.0
"""Time until a publisher with our profile of Fast DDS and a plain subscriber match, with and without its announcements.

    python benchmarks/late_subscribers/matching.py [--runs 25] [--out matching.csv]

`subscriber`: it is made while the publisher has been there for seconds; `publisher`: the other way round.
"""

from __future__ import annotations

import argparse
import csv
import os
import re
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent
PROFILE = HERE.parents[1] / "src" / "foretouch" / "ros" / "runtime" / "fastdds_shared_memory.xml"
SETTLED_S = 4.0  # until the first end has made all its first announcements
LONGEST_S = 15.0
COLUMNS = ("range", "announcements", "late", "runs", "median_s", "p90_s", "max_s", "over_half_a_second")


def keep(kind: str) -> None:
    """Be one end until the process is killed."""
    import rclpy

    node = _end(kind, None)
    sys.stdout.write("ready\n")
    sys.stdout.flush()
    rclpy.spin(node)


def match(kind: str, runs: int) -> None:
    """Make an end again and again, in a participant of its own, and print how long each takes to match [s]."""
    from rclpy.context import Context

    rng = np.random.default_rng(0)
    for _ in range(runs):
        context = Context()
        began = time.monotonic()
        node = _end(kind, context)
        while not _count(node, kind) and time.monotonic() - began < LONGEST_S:
            time.sleep(0.002)
        sys.stdout.write(f"{time.monotonic() - began}\n")
        node.destroy_node()
        context.shutdown()
        time.sleep(rng.uniform(0.0, 1.0))


def _end(kind: str, context: object) -> object:
    import rclpy
    from rclpy.node import Node
    from std_msgs.msg import Empty

    rclpy.init(context=context)
    node = Node(kind, context=context)
    if kind == "publisher":
        node.create_publisher(Empty, "touch", 10)
    else:
        node.create_subscription(Empty, "touch", print, 10)
    return node


def _count(node: object, kind: str) -> int:
    if kind == "publisher":
        return next(one for one in node.publishers if one.topic_name == "/touch").get_subscription_count()
    return next(node.subscriptions).get_publisher_count()


def measure(discovery: str, profile: Path, late: str, runs: int) -> list[float]:
    """The times of one row [s]."""
    from foretouch.ros.runtime.environment import profile_variable

    plain = {name: value for name, value in os.environ.items() if "PROFILES_FILE" not in name}
    plain |= {"ROS_AUTOMATIC_DISCOVERY_RANGE": discovery, "AMENT_PREFIX_PATH": sys.prefix}
    environ = {"publisher": {**plain, profile_variable(): str(profile)}, "subscriber": plain}
    early = "subscriber" if late == "publisher" else "publisher"
    me = [sys.executable, __file__]
    with subprocess.Popen([*me, "--keep", early], env=environ[early], stdout=subprocess.PIPE, text=True) as kept:
        kept.stdout.readline()
        time.sleep(SETTLED_S)
        command = [*me, "--match", late, "--runs", str(runs)]
        done = subprocess.run(command, env=environ[late], capture_output=True, text=True, check=True)
        kept.kill()
    return sorted(map(float, done.stdout.split()))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=25)
    parser.add_argument("--out", type=Path, default=HERE / "matching.csv")
    parser.add_argument("--keep", help=argparse.SUPPRESS)
    parser.add_argument("--match", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.keep:
        keep(options.keep)
    if options.match:
        match(options.match, options.runs)
        return 0
    text = PROFILE.read_text(encoding="utf-8")
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        default = Path(folder) / "default.xml"
        default.write_text(re.sub(r"<builtin>.*</builtin>", "", text, flags=re.DOTALL), encoding="utf-8")
        for discovery in ("LOCALHOST", "SUBNET"):
            for name, profile in (("of Fast DDS", default), ("ours", PROFILE)):
                for late in ("subscriber", "publisher"):
                    times = measure(discovery, profile, late, options.runs)
                    high = times[int(0.9 * (len(times) - 1))]
                    numbers = [f"{one:.2f}" for one in (statistics.median(times), high, times[-1])]
                    rows.append((discovery, name, late, len(times), *numbers, sum(one > 0.5 for one in times)))
                    print(*rows[-1], sep=", ", flush=True)
    with options.out.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file, lineterminator="\n").writerows([COLUMNS, *rows])
    return 0


if __name__ == "__main__":
    sys.exit(main())
