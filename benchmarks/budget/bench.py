# SPDX-License-Identifier: Apache-2.0
"""Does touch_predictor keep its latency budget, on an idle machine and under a load that comes and goes?

A real node over DDS; another process publishes clouds with 1, 10 or 100 grasps at a fixed rate. The time from the
receipt of a request to the call that publishes its answer is measured around the node, not by it, and compared with
the flags of the published message. Half a period after each request, a bare node of rclpy gets the same one and only
publishes a prepared answer: what it takes is the machine's own. The load is busy processes, twice as many as cores, for
two seconds of each four; the last rows are measured with real-time priority of the node under this load.
"""

from __future__ import annotations

import argparse
import contextlib
import csv
import gc
import itertools
import multiprocessing
import os
import statistics
import sys
import tempfile
import threading
import time
from collections.abc import Iterable, Sequence
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
from rclpy.qos import qos_profile_sensor_data  # noqa: E402
from sensor_msgs.msg import PointCloud2  # noqa: E402

from foretouch.models.budget import Answer, profile_scene  # noqa: E402
from foretouch.pipeline import FoundObject  # noqa: E402
from foretouch.ros.executables import make_nodes, spin  # noqa: E402
from foretouch.ros.messages.answers import TouchAnswer  # noqa: E402
from foretouch.ros.messages.clouds import objects_to_msg  # noqa: E402
from foretouch.ros.messages.conversions import grasp_to_msg  # noqa: E402
from foretouch.timing import MachineLoad, cpu_name  # noqa: E402
from foretouch.types import ASSUMED_TABLE, Touch, TouchPrediction  # noqa: E402
from foretouch_msgs.msg import GraspArray, TouchPredictionArray  # noqa: E402

HERE = Path(__file__).parent
IDLE, LOADED, PRIORITISED = LOADS = (
    "none",
    "comes and goes",
    "comes and goes, real-time priority",
)  # the node's priority
REALTIME = 10  # priority, of 1 to 99
COUNTS, SHARES = (1, 10, 100), (0.6, 0.35, 0.05)
PERIOD_S = 2.0  # of the load, on and off
PREDICTOR, ECHO = "/foretouch", "/echo"
LATE, REDUCED = (b"".join((len(flag).to_bytes(4, "little"), flag)) for flag in (b"late\0", b"reduced\0"))
MARKS = "<!-- results -->\n", "<!-- end of results -->\n"
SHOWN = {
    "budget_ms": "budget [ms]",
    "load": "load",
    "met_percent": "met [%]",
    "met_but_for_waits_percent": "met, waits for a core left out [%]",
    "late_and_flagged_percent": "late and flagged [%]",
    "best_skill_percent": "best level [%]",
    "p50_ms": "p50 [ms]",
    "p99_ms": "p99 [ms]",
    "echo_p50_ms": "echo p50 [ms]",
    "echo_p99_ms": "echo p99 [ms]",
    "echo_late_percent": "echo late [%]",
}


@dataclass
class Seen:
    """One published answer."""

    at: float  # time of publication [s]
    count: int  # grasps
    seconds: float  # from receipt to the call that publishes
    waited: float  # of this, for which its thread was ready but got no core [s]
    late: bool  # as flagged
    reduced: bool  # as flagged
    level: str
    skill: float
    best: float  # skill of the best level that the budget affords on the machine as profiled
    affordable: bool


def requests(number: int) -> tuple[PointCloud2, list[Any], list[int]]:
    """The object, 100 grasps on it, and how many of them each request has."""
    cloud, made = profile_scene(max(COUNTS))
    message = objects_to_msg([FoundObject("1", cloud, ASSUMED_TABLE)], "cam", 1)
    return (
        message,
        [grasp_to_msg(one) for one in made],
        np.random.default_rng(0).choice(COUNTS, number, p=SHARES).tolist(),
    )


def publish(domain: int, number: int, rate_hz: float, begin: multiprocessing.synchronize.Event) -> None:
    """Publish requests at a fixed rate to the predictor and, between these, to the echo; runs in a process of its own."""
    rclpy.init(domain_id=domain)
    node = Node("source")
    outputs = {space: (node.create_publisher(PointCloud2, f"{space}/object_cloud", 10),
                       node.create_publisher(GraspArray, f"{space}/grasps", 10)) for space in (PREDICTOR, ECHO)}  # fmt: skip
    message, posed, counts = requests(number)
    while not all(one.get_subscription_count() for pair in outputs.values() for one in pair):
        time.sleep(0.05)
    time.sleep(0.5)
    begin.wait()
    start = time.monotonic()
    for k, count in enumerate(counts):
        for half, (clouds, grasps) in enumerate(outputs.values()):
            time.sleep(max(0.0, start + (k + half / 2) / rate_hz - time.monotonic()))
            message.header.stamp = node.get_clock().now().to_msg()
            clouds.publish(message)
            grasps.publish(GraspArray(header=message.header, grasps=posed[:count]))
    time.sleep(1.0)
    rclpy.try_shutdown()


def echo(domain: int, results: multiprocessing.queues.Queue, end: multiprocessing.synchronize.Event) -> None:
    """A node of rclpy alone: from the receipt of a cloud to the call that publishes an answer [s]."""
    rclpy.init(domain_id=domain)
    node = Node("echo")
    message, posed, _ = requests(0)
    touch = Touch.from_vector(np.arange(50.0))
    outcomes = [TouchPrediction(None, touch, touch, touch)] * len(posed)  # type: ignore[arg-type]
    answers = {count: TouchAnswer(message.header, posed[:count], outcomes[:count]).encoded() for count in COUNTS}
    publisher = node.create_publisher(TouchPredictionArray, f"{ECHO}/touch", 10)
    took, arrived = [], {}

    def receive_cloud(cloud: PointCloud2) -> None:
        arrived[cloud.header.stamp.sec, cloud.header.stamp.nanosec] = time.monotonic()

    def receive_grasps(grasps: GraspArray) -> None:
        began = arrived.pop((grasps.header.stamp.sec, grasps.header.stamp.nanosec), None)
        answer = answers[len(grasps.grasps)]
        if began is not None:
            took.append(time.monotonic() - began)
            publisher.publish(answer)

    node.create_subscription(PointCloud2, f"{ECHO}/object_cloud", receive_cloud, qos_profile_sensor_data)
    node.create_subscription(GraspArray, f"{ECHO}/grasps", receive_grasps, qos_profile_sensor_data)
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    while not end.is_set():
        executor.spin_once(timeout_sec=0.2)
    results.put(took)
    rclpy.try_shutdown()


def burn(on: multiprocessing.synchronize.Event, end: multiprocessing.synchronize.Event) -> None:
    """Use a core while `on` is set."""
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))  # not that of the parent
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


class Waits(threading.local):
    """How long the current thread has been ready to run without a core, so far."""

    def __init__(self) -> None:
        try:
            self._file = os.open(f"/proc/self/task/{threading.get_native_id()}/schedstat", os.O_RDONLY)
        except OSError:  # another system
            self._file = -1

    def seconds(self) -> float:
        """Time [s]; 0 where the system does not tell it."""
        return int(os.pread(self._file, 100, 0).split()[1]) / 1e9 if self._file >= 0 else 0.0


def watch(node: Any, seen: list[tuple[Any, ...]]) -> None:
    """Record each answer of the topic as it is published."""
    budget, publisher, sets = node._predictor.budget, node._touch, node._synchronizer  # noqa: SLF001
    begin, original, first = budget.begin, publisher.publish, sets._on_first  # noqa: SLF001
    waits, begun, received = Waits(), {}, {}

    def receive() -> float:
        arrived = first()
        received[arrived] = threading.get_ident(), waits.seconds()
        return arrived

    def note(count: int, arrived: float) -> Answer:
        begun["answer"], begun["count"] = begin(count, arrived), count
        return begun["answer"]

    def published(message: bytes) -> None:
        now = time.monotonic()
        thread, before = received.pop(node.arrived, (0, 0.0))
        waited = waits.seconds() - before if thread == threading.get_ident() else 0.0
        original(message)
        seen.append((now, now - node.arrived, waited, begun["answer"], begun["count"], message))

    budget.begin, publisher.publish, sets._on_first = note, published, receive  # noqa: SLF001


def measure(
    budget_ms: float, number: int, rate_hz: float, load_name: str
) -> tuple[list[Seen], list[float], list[tuple[float, float]], str]:
    """One node, one budget; its answers, the times of the echo [s], the spans of the load, and the state of the profile."""
    domain = 1 + os.getpid() % 80
    context = multiprocessing.get_context("spawn")
    begin, end, results = context.Event(), context.Event(), context.Queue()
    others = [
        context.Process(target=publish, args=(domain, number, rate_hz, begin), daemon=True),
        context.Process(target=echo, args=(domain, results, end), daemon=True),
    ]
    for one in others:
        one.start()
    if load_name == PRIORITISED:
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(REALTIME))  # the threads that follow inherit it
    rclpy.init(domain_id=domain)
    overrides = [Parameter("latency_budget_ms", value=budget_ms), Parameter("late_after_s", value=0.0)]
    (node,) = make_nodes("touch_predictor", parameter_overrides=overrides)
    thread = threading.Thread(target=serve, args=(node,), daemon=True)
    thread.start()
    while node.state_name != "active":
        time.sleep(0.05)
    raw: list[tuple[Any, ...]] = []
    watch(node, raw)
    with Load(active=load_name != IDLE) as load:
        begin.set()
        others[0].join(60.0 + 3.0 * number / rate_hz)
    end.set()
    echoed = results.get(timeout=60.0)
    others[1].join(10.0)
    budget = node._predictor.budget  # noqa: SLF001
    seen = []
    for at, seconds, waited, answer, count, data in raw:
        best = budget.affordable(count)
        skill = answer.level.skill
        seen.append(Seen(at, count, seconds, waited, LATE in data, REDUCED in data, answer.level.name, skill,
                         skill if best is None else best.skill, best is not None))  # fmt: skip
    rclpy.try_shutdown()
    thread.join(10.0)
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    return seen, echoed, load.spans, budget.notes()["budget.profile"].rpartition("(")[2].rstrip(")")


def serve(node: Any) -> None:
    """As the node's executable does."""
    with contextlib.suppress(ExternalShutdownException):
        spin([node])


def summarise(budget_ms: float, seen: list[Seen], echoed: list[float], sent: int, load_name: str) -> dict[str, Any]:
    """One row of the table."""
    took, echo_ms = (np.array([*values, np.nan]) * 1e3 for values in ([one.seconds for one in seen], echoed))
    took = took[:-1]
    could, flagged = (np.array([getattr(one, name) for one in seen], bool) for name in ("affordable", "late"))
    beyond = took > budget_ms
    by_waits = beyond & (took - 1e3 * np.array([one.waited for one in seen]) <= budget_ms)
    within = np.array([one.skill >= 0.99 * one.best for one in seen], bool)
    share = lambda mask: round(100.0 * float(mask.mean()), 2) if mask.size else None  # noqa: E731
    quantiles = lambda values: [round(float(np.nanquantile(values, q)), 3) for q in (0.5, 0.95, 0.99)]  # noqa: E731
    p50, p95, p99 = quantiles(took)
    echo50, echo95, echo99 = quantiles(echo_ms)
    levels = {name: sum(one.level == name for one in seen) for name in dict.fromkeys(one.level for one in seen)}
    return {
        "budget_ms": budget_ms,
        "load": load_name,
        "answers": len(seen),
        "dropped": sent - len(seen),
        "affordable": int(could.sum()),
        "met_percent": share(~beyond[could]),
        "late_by_waits": int(by_waits.sum()),
        "met_but_for_waits_percent": share(~beyond[could & ~by_waits]),
        "late": int(beyond.sum()),
        "late_and_flagged_percent": share(flagged[beyond]),
        "flagged_and_not_late": int((flagged & ~beyond).sum()),
        "best_skill_percent": share(within[could]),
        "reduced": sum(one.reduced for one in seen),
        "mean_skill": round(statistics.fmean(one.skill for one in seen), 4),
        "levels": "; ".join(f"{count} {name}" for name, count in sorted(levels.items(), key=lambda item: -item[1])),
        "p50_ms": p50,
        "p95_ms": p95,
        "p99_ms": p99,
        "echo_p50_ms": echo50,
        "echo_p95_ms": echo95,
        "echo_p99_ms": echo99,
        "echo_late_percent": share(echo_ms[:-1] > budget_ms),
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


def write(rows: Sequence[dict[str, Any]], folder: Path) -> None:
    """All rows so far; in the committed folder also the table of the README."""
    with (folder / "results.csv").open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    readme = HERE / "README.md"
    if folder.resolve() == (HERE / "results").resolve():
        begin, rest = readme.read_text(encoding="utf-8").split(MARKS[0])
        readme.write_text(f"{begin}{MARKS[0]}{table(rows)}{MARKS[1]}{rest.split(MARKS[1])[1]}", encoding="utf-8")


def table(rows: Iterable[dict[str, Any]]) -> str:
    """The main columns as Markdown, and the machine."""
    lines = [f"| {' | '.join(SHOWN.values())} |", "|---" * len(SHOWN) + "|"]
    last: dict[str, Any] = {}
    for last in rows:
        lines.append(f"| {' | '.join(str(last[name]) or '–' for name in SHOWN)} |")
    machine = f"{last['number']} requests a row at {last['rate_hz']} Hz; {last['cpu']}, {last['cores']} cores"
    others = ", ".join(str(row["other_cores"]) for row in rows)
    return "\n".join(
        ["", *lines, "", f"{machine}. Cores that other processes used meanwhile, by row: {others}.", "", ""]
    )


def children_s() -> float:
    """Processor time of the processes that this one has ended [s]."""
    times = os.times()
    return times.children_user + times.children_system


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--budgets", type=float, nargs="+", default=[5.0, 10.0, 20.0, 50.0])
    parser.add_argument("--count", "--number", type=int, default=1000, help="requests of each run; 100 take 6 s")
    parser.add_argument("--rate-hz", type=float, default=40.0)
    parser.add_argument(
        "--loads", choices=LOADS, nargs="+", default=LOADS, help="real-time priority needs the right to it, as of root"
    )
    parser.add_argument("--resume", action="store_true", help="keep the rows that are there, and measure the others")
    parser.add_argument("-o", "--out", type=Path, default=HERE / "results")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:  # the profile is measured once, as the machine is now
        os.environ["XDG_CACHE_HOME"] = folder
        run(arguments)


def run(arguments: argparse.Namespace) -> None:
    """Measure all rows that are asked for and not there."""
    file = arguments.out / "results.csv"
    rows: list[dict[str, Any]] = []
    if arguments.resume and file.exists():
        rows = list(csv.DictReader(file.open(encoding="utf-8")))
    kept = {(float(row["budget_ms"]), row["load"]) for row in rows}
    for load_name, budget_ms in itertools.product(arguments.loads, arguments.budgets):
        if (budget_ms, load_name) in kept:
            continue
        gc.collect()  # the participants of the last row would stay until then, and answer to announcements
        machine, children, began = MachineLoad(), children_s(), time.monotonic()
        seen, echoed, spans, profile = measure(budget_ms, arguments.count, arguments.rate_hz, load_name)
        own = (children_s() - children) / (time.monotonic() - began)
        others = round(max(0.0, float(machine.row()["other_cores"]) - own), 2)
        row = summarise(budget_ms, seen, echoed, arguments.count, load_name) | {
            "number": arguments.count,
            "rate_hz": arguments.rate_hz,
            "profile": profile,
            "other_cores": others,
            "cpu": cpu_name(),
            "cores": len(os.sched_getaffinity(0)),
        }
        rows.append(row)
        write(rows, arguments.out)
        print({key: row[key] for key in list(row)[:-2]}, flush=True)
        if load_name == LOADED and budget_ms == 10.0:
            draw(seen, spans, budget_ms, arguments.out / "budget.png")


if __name__ == "__main__":
    sys.exit(main())
