# SPDX-License-Identifier: Apache-2.0
"""Does touch_predictor keep its latency budget, on an idle machine and under a load that comes and goes?

A real node over DDS; another process publishes clouds with 1, 10 or 100 grasps at a fixed rate. The time from the
receipt of a request to the call that publishes its answer is measured around the node, not by it, and compared with
the flags of the published message. The load is busy processes, twice as many as cores, for two seconds of each four.
"""

from __future__ import annotations

import argparse
import contextlib
import csv
import itertools
import multiprocessing
import os
import sys
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np

from foretouch.ros.runtime.environment import prepare_environment

prepare_environment()

import rclpy  # noqa: E402
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor  # noqa: E402
from rclpy.node import Node  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402
from sensor_msgs.msg import PointCloud2  # noqa: E402

from foretouch.experiments.framework.manifest import environment  # noqa: E402
from foretouch.pipeline import FoundObject  # noqa: E402
from foretouch.ros.executables import make_nodes  # noqa: E402
from foretouch.ros.messages.clouds import objects_to_msg  # noqa: E402
from foretouch.ros.messages.conversions import grasp_to_msg  # noqa: E402
from foretouch.tradeoff.budget import Answer  # noqa: E402
from foretouch.tradeoff.budget.profile import profile_scene  # noqa: E402
from foretouch.tradeoff.timing import MachineLoad  # noqa: E402
from foretouch.types import ASSUMED_TABLE  # noqa: E402
from foretouch_msgs.msg import GraspArray, TouchPredictionArray  # noqa: E402

HERE = Path(__file__).parent
COUNTS, SHARES = (1, 10, 100), (0.6, 0.35, 0.05)
PERIOD_S = 2.0  # of the load, on and off


@dataclass
class Seen:
    """One published answer."""

    at: float  # time of publication [s]
    count: int  # grasps
    seconds: float  # from receipt to the call that publishes
    late: bool  # as flagged
    reduced: bool  # as flagged
    level: str
    skill: float
    best: float  # skill of the best level that the budget affords on the machine as profiled
    affordable: bool


def publish(domain: int, number: int, rate_hz: float, begin: multiprocessing.synchronize.Event) -> None:
    """Publish requests at a fixed rate; runs in a process of its own."""
    rclpy.init(domain_id=domain)
    node = Node("source", namespace="/foretouch")
    clouds = node.create_publisher(PointCloud2, "object_cloud", 10)
    grasps = node.create_publisher(GraspArray, "grasps", 10)
    cloud, made = profile_scene(max(COUNTS))
    message = objects_to_msg([FoundObject("1", cloud, ASSUMED_TABLE)], "cam", 1)
    posed = [grasp_to_msg(one) for one in made]
    counts = np.random.default_rng(0).choice(COUNTS, number, p=SHARES)
    while not (clouds.get_subscription_count() and grasps.get_subscription_count()):
        time.sleep(0.05)
    time.sleep(0.5)
    begin.wait()
    start = time.monotonic()
    for k, count in enumerate(counts):
        time.sleep(max(0.0, start + k / rate_hz - time.monotonic()))
        message.header.stamp = node.get_clock().now().to_msg()
        clouds.publish(message)
        grasps.publish(GraspArray(header=message.header, grasps=posed[:count]))
    time.sleep(2.0)
    rclpy.try_shutdown()


def burn(on: multiprocessing.synchronize.Event, end: multiprocessing.synchronize.Event) -> None:
    """Use a core while `on` is set."""
    while not end.is_set():
        if on.wait(0.05):
            stop = time.monotonic() + 0.01
            while time.monotonic() < stop:
                pass


class Load:
    """Busy processes that come and go while the context lasts."""

    def __init__(self, *, active: bool) -> None:
        context = multiprocessing.get_context("spawn")
        self._on, self._end = context.Event(), context.Event()
        count = 2 * len(os.sched_getaffinity(0)) if active else 0
        self._processes = [context.Process(target=burn, args=(self._on, self._end), daemon=True) for _ in range(count)]
        self.spans: list[tuple[float, float]] = []

    def __enter__(self) -> Self:
        for process in self._processes:
            process.start()
        if self._processes:
            threading.Thread(target=self._switch, daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        self._end.set()
        for process in self._processes:
            process.join(5.0)

    def _switch(self) -> None:
        while not self._end.wait(PERIOD_S):
            began = time.monotonic()
            self._on.set()
            self._end.wait(PERIOD_S)
            self._on.clear()
            self.spans.append((began, time.monotonic()))


def watch(node: Any, seen: list[Seen]) -> None:
    """Record each answer of the topic as it is published."""
    budget, publisher = node._predictor.budget, node._touch  # noqa: SLF001
    begun = {}
    begin, original = budget.begin, publisher.publish

    def note(count: int, arrived: float) -> Answer:
        begun["answer"] = begin(count, arrived)
        return begun["answer"]

    def published(message: TouchPredictionArray) -> None:
        now, answer = time.monotonic(), begun["answer"]
        flags = message.predictions[0].flags
        best = budget.affordable(answer.count)
        seen.append(
            Seen(now, answer.count, now - node.arrived, "late" in flags, "reduced" in flags, answer.level.name,
                 answer.level.skill, answer.level.skill if best is None else best.skill, best is not None)
        )  # fmt: skip
        original(message)

    budget.begin, publisher.publish = note, published


def measure(budget_ms: float, number: int, rate_hz: float, *, loaded: bool) -> tuple[list[Seen], list, int]:
    """One node, one budget; the answers, the spans of the load, and the number of requests without an answer."""
    domain = 1 + os.getpid() % 80
    rclpy.init(domain_id=domain)
    overrides = [Parameter("latency_budget_ms", value=budget_ms), Parameter("late_after_s", value=0.0)]
    (node,) = make_nodes("touch_predictor", parameter_overrides=overrides)
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    node.autostart()
    seen: list[Seen] = []
    watch(node, seen)

    def serve() -> None:
        with contextlib.suppress(ExternalShutdownException):
            executor.spin()

    thread = threading.Thread(target=serve, daemon=True)
    thread.start()
    context = multiprocessing.get_context("spawn")
    begin = context.Event()
    source = context.Process(target=publish, args=(domain, number, rate_hz, begin), daemon=True)
    source.start()
    with Load(active=loaded) as load:
        begin.set()
        source.join()
    executor.shutdown(timeout_sec=2.0)
    thread.join(5.0)
    node.destroy_node()
    rclpy.try_shutdown()
    return seen, load.spans, number - len(seen)


def summarise(budget_ms: float, seen: list[Seen], lost: int, *, loaded: bool) -> dict:
    """One row of the table."""
    took = np.array([one.seconds for one in seen]) * 1e3
    could = np.array([one.affordable for one in seen])
    beyond = took > budget_ms
    flagged = np.array([one.late for one in seen])
    within = np.array([one.skill >= 0.99 * one.best for one in seen])
    share = lambda mask: round(100.0 * float(mask.mean()), 2) if mask.size else None  # noqa: E731
    return {
        "budget_ms": budget_ms,
        "load": "comes and goes" if loaded else "none",
        "answers": len(seen),
        "dropped": lost,
        "affordable": int(could.sum()),
        "met_percent": share(~beyond[could]),
        "late": int(beyond.sum()),
        "late_and_flagged_percent": share(flagged[beyond]),
        "flagged_and_not_late": int((flagged & ~beyond).sum()),
        "best_skill_percent": share(within[could]),
        "reduced": sum(one.reduced for one in seen),
        "mean_skill": round(float(np.mean([one.skill for one in seen])), 4),
        "p50_ms": round(float(np.quantile(took, 0.5)), 3),
        "p95_ms": round(float(np.quantile(took, 0.95)), 3),
        "p99_ms": round(float(np.quantile(took, 0.99)), 3),
    }


def draw(seen: list[Seen], spans: list, budget_ms: float, path: Path) -> None:
    """Latency and skill over time, with the load."""
    from foretouch.report.panels import new_figure, save

    figure = new_figure(9.0, 5.0)
    above, below = figure.subplots(2, 1, sharex=True)
    start = seen[0].at
    for k, (a, b) in enumerate(spans):
        for axes in (above, below):
            axes.axvspan(a - start, b - start, color="0.88", label="busy processes" if k == 0 else None)
    for number, count in enumerate(COUNTS):
        chosen = [one for one in seen if one.count == count]
        at = [one.at - start for one in chosen]
        above.plot(
            at, [one.seconds * 1e3 for one in chosen], ".", markersize=3, color=f"C{number}", label=f"{count} grasps"
        )
        below.plot(at, [one.skill for one in chosen], ".", markersize=3, color=f"C{number}")
    above.axhline(budget_ms, color="black", linewidth=0.8)
    above.set_yscale("log")
    above.set_ylabel("receipt to publication [ms]")
    below.set_ylabel("skill of the level used")
    below.set_xlabel("time [s]")
    below.set_xlim(0.0, seen[-1].at - start)
    figure.legend(*above.get_legend_handles_labels(), loc="outside upper center", ncols=4, fontsize=8)
    save(figure, path)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--budgets", type=float, nargs="+", default=[5.0, 10.0, 20.0, 50.0])
    parser.add_argument("--number", type=int, default=1000, help="requests of each run")
    parser.add_argument("--rate-hz", type=float, default=40.0)
    parser.add_argument(
        "--load", choices=("none", "both"), default="both", help="`none` leaves out the runs under load"
    )
    parser.add_argument("-o", "--out", type=Path, default=HERE / "results")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    rows = []
    for loaded, budget_ms in itertools.product((False, True)[: 1 + (arguments.load == "both")], arguments.budgets):
        machine = MachineLoad()
        seen, spans, lost = measure(budget_ms, arguments.number, arguments.rate_hz, loaded=loaded)
        row = summarise(budget_ms, seen, lost, loaded=loaded)
        own = machine.row()
        row |= {
            "other_cores": own["other_cores"],
            "cpu": environment(1, None)["cpu"],
            "cores": len(os.sched_getaffinity(0)),
        }
        rows.append(row)
        print({key: row[key] for key in list(row)[:-2]}, flush=True)
        if loaded and budget_ms == 10.0:
            draw(seen, spans, budget_ms, arguments.out / "budget.png")
    with (arguments.out / "results.csv").open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


if __name__ == "__main__":
    sys.exit(main())
