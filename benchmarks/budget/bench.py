# SPDX-License-Identifier: Apache-2.0
"""Does touch_predictor keep its latency budget, on an idle machine and under a load that comes and goes?

A real node over DDS; another process publishes clouds with 1, 10 or 100 grasps at a fixed rate. The time from the
receipt of a request to the call that publishes its answer is measured around the node, not by it, and compared with
the flags of the published message. The load is busy processes, twice as many as cores, for two seconds of each four;
the last rows are measured with real-time priority of the node under this load.
"""

import argparse
import contextlib
import gc
import itertools
import multiprocessing
import os
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.ros import prepare_domain

if __name__ == "__main__":  # processes that this one starts inherit it
    prepare_domain(1 + os.getpid() % 80)

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import PointCloud2

from benchmarks.common import OthersLoad, markdown, print_rows, replace_marked, write_csv
from foretouch.models.budget import Answer, profile_scene
from foretouch.models.timing import cpu_name
from foretouch.pipeline import FoundObject
from foretouch.ros.executables import make_nodes, spin
from foretouch.ros.messages.clouds import objects_to_msg
from foretouch.ros.messages.conversions import grasp_to_msg
from foretouch.types import ASSUMED_TABLE
from foretouch_msgs.msg import GraspArray

HERE = Path(__file__).parent
LOADS = IDLE, _, PRIORITISED = "none", "comes and goes", "comes and goes, real-time priority"  # the node's priority
REALTIME = 10  # priority, of 1 to 99
COUNTS, SHARES = (1, 10, 100), (0.6, 0.35, 0.05)
PERIOD_S = 2.0  # of the load, on and off
SHOWN = {
    "budget_ms": "budget [ms]",
    "load": "load",
    "met_percent": "met [%]",
    "met_but_for_waits_percent": "met, waits for a core left out [%]",
    "late_and_flagged_percent": "late and flagged [%]",
    "best_skill_percent": "best level [%]",
    "p50_ms": "p50 [ms]",
    "p99_ms": "p99 [ms]",
}


def publish(number: int, rate_hz: float, begin: Any) -> None:
    """Publish requests at a fixed rate; runs in a process of its own."""
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)  # it ends with its parent
    node = Node("source", namespace="/foretouch")
    outputs = [node.create_publisher(PointCloud2, "object_cloud", 10), node.create_publisher(GraspArray, "grasps", 10)]
    cloud, grasps = profile_scene(max(COUNTS))
    message = objects_to_msg([FoundObject("1", cloud, ASSUMED_TABLE)], "cam", 1)
    posed = [grasp_to_msg(one) for one in grasps]
    until = time.monotonic() + 120.0
    while not all(one.get_subscription_count() for one in outputs):
        if time.monotonic() > until:
            raise SystemExit("the node does not subscribe to object_cloud and grasps")
        time.sleep(0.05)
    time.sleep(0.5)
    begin.wait()
    start = time.monotonic()
    for k, count in enumerate(np.random.default_rng(0).choice(COUNTS, number, p=SHARES).tolist()):
        time.sleep(max(0.0, start + k / rate_hz - time.monotonic()))
        message.header.stamp = node.get_clock().now().to_msg()
        outputs[0].publish(message)
        outputs[1].publish(GraspArray(header=message.header, grasps=posed[:count]))
    time.sleep(1.0)
    rclpy.try_shutdown()


BUSY = f"""
import os, time
os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))  # not that of the parent
while True:
    if time.time() % {2 * PERIOD_S} > {PERIOD_S}:
        time.sleep(0.05)
"""


@contextlib.contextmanager
def load(*, active: bool) -> Iterator[None]:
    """Busy processes that come and go, two for each core, while the context lasts."""
    count = 2 * len(os.sched_getaffinity(0)) if active else 0
    processes = [subprocess.Popen([sys.executable, "-c", BUSY]) for _ in range(count)]
    try:
        yield
    finally:
        for process in processes:
            process.kill()
            process.wait()


class Waits(threading.local):
    """How long the current thread has been ready to run without a core, so far."""

    def __init__(self) -> None:
        try:
            self._file = os.open(f"/proc/self/task/{threading.get_native_id()}/schedstat", os.O_RDONLY)
        except OSError:  # another system
            self._file = -1

    def seconds(self) -> float:
        """Time [s]; 0 where the system does not report it."""
        return int(os.pread(self._file, 100, 0).split()[1]) / 1e9 if self._file >= 0 else 0.0


def watch(node: Any, seen: list[tuple[Any, ...]]) -> None:
    """Record each answer of the topic as it is published."""
    budget, publisher, sets = node._predictor.budget, node._touch, node._synchronizer  # noqa: SLF001
    begin, original, first = budget.begin, publisher.publish, sets.on_first
    waits, begun, received = Waits(), {}, {}

    def receive() -> float:
        arrived = first()
        received[arrived] = threading.get_ident(), waits.seconds()
        return arrived

    def note(count: int, arrived: float) -> Answer:
        begun["one"] = begin(count, arrived), count
        return begun["one"][0]

    def published(message: Any) -> None:
        now = time.monotonic()
        answer, count = begun["one"]
        thread, before = received.pop(answer.arrived, (0, 0.0))
        waited = waits.seconds() - before if thread == threading.get_ident() else 0.0
        original(message)
        seen.append((now - answer.arrived, waited, answer, count, message))

    budget.begin, publisher.publish, sets.on_first = note, published, receive


def measure(budget_ms: float, number: int, rate_hz: float, load_name: str) -> tuple[list[dict[str, Any]], str]:
    """One node, one budget; its answers, and the state of the machine when the profile was measured."""
    context = multiprocessing.get_context("spawn")
    begin = context.Event()
    source = context.Process(target=publish, args=(number, rate_hz, begin), daemon=True)
    source.start()
    if load_name == PRIORITISED:
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(REALTIME))  # the threads that follow inherit it
    rclpy.init()
    overrides = [Parameter("latency_budget_ms", value=budget_ms), Parameter("late_after_s", value=0.0)]
    (node,) = make_nodes("touch_predictor", parameter_overrides=overrides)
    thread = threading.Thread(target=serve, args=(node,), daemon=True)
    thread.start()
    while node.state_name != "active":
        time.sleep(0.05)
    raw: list[tuple[Any, ...]] = []
    watch(node, raw)
    with load(active=load_name != IDLE):
        begin.set()
        source.join(60.0 + 3.0 * number / rate_hz)
    budget = node._predictor.budget  # noqa: SLF001
    seen = []
    for seconds, waited, answer, count, message in raw:
        best, skill = budget.affordable(count), answer.level.skill
        seen.append(
            {
                "ms": 1e3 * seconds,  # from receipt to the call that publishes
                "waited_ms": 1e3 * waited,  # of this, for which its thread was ready but got no core
                "late": any("late" in one.flags for one in message.predictions),
                "reduced": any("reduced" in one.flags for one in message.predictions),
                "level": answer.level.name,
                "skill": skill,
                "affordable": best is not None,  # on the machine as profiled
                "within": skill >= 0.99 * (skill if best is None else best.skill),
            }
        )
    rclpy.try_shutdown()
    thread.join(10.0)
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    return seen, budget.notes()["budget.profile"].rpartition("(")[2].rstrip(")")


def serve(node: Any) -> None:
    """As the node's executable does."""
    with contextlib.suppress(ExternalShutdownException):
        spin([node])


def summarise(seen: list[dict[str, Any]], budget_ms: float) -> dict[str, Any]:
    """Counts and shares of one row of the table."""
    column = {name: np.array([one[name] for one in seen]) for name in seen[0]}
    could, beyond = column["affordable"], column["ms"] > budget_ms
    by_waits = beyond & (column["ms"] - column["waited_ms"] <= budget_ms)
    levels = Counter(one["level"] for one in seen)

    def share(mask: Any) -> float | None:
        return round(100.0 * float(mask.mean()), 2) if mask.size else None

    return {
        "affordable": int(could.sum()),
        "met_percent": share(~beyond[could]),
        "late_by_waits": int(by_waits.sum()),
        "met_but_for_waits_percent": share(~beyond[could & ~by_waits]),
        "late": int(beyond.sum()),
        "late_and_flagged_percent": share(column["late"][beyond]),
        "flagged_and_not_late": int((column["late"] & ~beyond).sum()),
        "best_skill_percent": share(column["within"][could]),
        "reduced": int(column["reduced"].sum()),
        "mean_skill": round(float(column["skill"].mean()), 4),
        "levels": "; ".join(f"{count} {name}" for name, count in levels.most_common()),
        **{f"p{q}_ms": round(float(np.percentile(column["ms"], q)), 3) for q in (50, 95, 99)},
    }


def write(rows: Sequence[dict[str, Any]], path: Path) -> None:
    """All rows so far; in the committed folder also the table of the README."""
    write_csv(path, rows)
    if path.parent.resolve() == HERE.resolve():
        cells = [["–" if row[name] in ("", None) else row[name] for name in SHOWN] for row in rows]
        last, others = rows[-1], ", ".join(str(row["other_cores"]) for row in rows)
        machine = f"{last['number']} requests a row at {last['rate_hz']} Hz; {last['cpu']}, {last['cores']} cores"
        note = f"{machine}. Cores that others used meanwhile, by row: {others}."
        replace_marked(HERE / "README.md", f"{markdown(list(SHOWN.values()), cells)}\n{note}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--budgets", type=float, nargs="+", default=[5.0, 10.0, 20.0, 50.0])
    parser.add_argument("--count", type=int, default=1000, help="requests of each run; 100 take 6 s")
    parser.add_argument("--rate-hz", type=float, default=40.0)
    parser.add_argument(
        "--loads", choices=LOADS, nargs="+", default=LOADS, help="real-time priority needs the right to it, as of root"
    )
    parser.add_argument("-o", "--out", type=Path, default=HERE / "results.csv")
    arguments = parser.parse_args()
    rows: list[dict[str, Any]] = []
    for load_name, budget_ms in itertools.product(arguments.loads, arguments.budgets):
        gc.collect()  # the participants of the last row would stay until then, and answer to announcements
        others = OthersLoad()
        seen, profile = measure(budget_ms, arguments.count, arguments.rate_hz, load_name)
        answered = {
            "budget_ms": budget_ms,
            "load": load_name,
            "answers": len(seen),
            "dropped": arguments.count - len(seen),
        }
        setup = {
            "number": arguments.count,
            "rate_hz": arguments.rate_hz,
            "profile": profile,
            "other_cores": others.cores(),
        }
        rows.append(
            {
                **answered,
                **summarise(seen, budget_ms),
                **setup,
                "cpu": cpu_name(),
                "cores": len(os.sched_getaffinity(0)),
            }
        )
        write(rows, arguments.out)
        print_rows(rows[-1:])


if __name__ == "__main__":
    main()
