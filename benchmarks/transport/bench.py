# SPDX-License-Identifier: Apache-2.0
"""Stamp of a cloud to received touch: latency, processor time and losses (see README.md)."""

import argparse
import itertools
import os
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import PointCloud2

from benchmarks.common import ROOT, OthersLoad, markdown, print_rows, read_csv, replace_marked, write_csv
from benchmarks.ros import Client, end, prepare_domain, spawn, stamp_ns, stamped
from benchmarks.transport.round_trip import compare
from foretouch.errors import ConfigError
from foretouch.pipeline import Pipeline
from foretouch.report.panels import new_figure, save_small
from foretouch.ros.messages.clouds import cloud_to_msg
from foretouch.types import Cloud
from foretouch_lab.simulation.depth_scene import random_scene
from foretouch_msgs.msg import TouchPredictionArray

DOMAIN = 87
RESULTS = Path(__file__).with_name("results.csv")
REQUESTS = Path(__file__).with_name("requests.csv")
PICTURE = ROOT / "docs" / "stamp_to_touch.png"
NODES = ("perception",)
PERCENTILES = ("p50_ms", "p95_ms", "p99_ms")
RATES = [1.0, 2.0, 5.0, 10.0, 20.0, 30.0, 45.0, 60.0, 75.0, 90.0]
REST_S = 3.0  # without clouds


def cpu_s(pid: int) -> float:
    """Processor time of all threads of a process so far [s]."""
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
    return sum(map(int, fields[11:13])) / os.sysconf("SC_CLK_TCK")


class Bench(Client):
    """Publisher of clouds and subscriber of answers."""

    def __init__(self) -> None:
        super().__init__("transport_bench", DOMAIN)
        self.answers: dict[int, tuple[int, list[float]]] = {}  # by stamp: time of arrival [ns], predicted pressures
        self._clouds = self.node.create_publisher(PointCloud2, "points", qos_profile_sensor_data)
        self.node.create_subscription(TouchPredictionArray, "touch", self._hear, self.deep)
        self.serve()

    def ready(self) -> None:
        """Wait until all nodes are active and connected."""
        wanted = {"points": 1, "touch": 1}

        def connected() -> bool:
            return self.is_active(NODES) and all(
                self.node.count_subscribers(topic) >= count and self.node.count_publishers(topic) >= 1
                for topic, count in wanted.items()
            )

        if not self.wait(connected, 120.0):
            raise SystemExit("the graph does not come up")
        time.sleep(1.5)

    def send(self, message: Any) -> int:
        """Publish a cloud with a stamp of this moment, which is returned [ns]."""
        stamp = stamped(message)
        self._clouds.publish(message)
        return stamp

    def send_at(self, messages: Sequence[Any], rate_hz: float, seconds: float) -> list[int]:
        """Publish clouds in turn at a rate; returns their stamps [ns]."""
        begin, stamps = time.monotonic(), []
        for number in range(round(rate_hz * seconds)):
            time.sleep(max(0.0, begin + number / rate_hz - time.monotonic()))
            stamps.append(self.send(messages[number % len(messages)]))
        self.wait(lambda: all(stamp in self.answers for stamp in stamps), 3.0)
        return stamps

    def _hear(self, message: Any) -> None:
        arrived = time.time_ns()  # whole messages of ten minutes would take gigabytes
        values = [value for touch in message.predictions for value in touch.scalars]
        self.answers[stamp_ns(message.header.stamp)] = arrived, values


def scenes(n_objects: int = 3, count: int = 5) -> list[Cloud]:
    """Clouds (480, 848) of seeded scenes, with noise and without stamps, in which all objects are found."""
    clouds: list[Cloud] = []
    for seed in itertools.takewhile(lambda _: len(clouds) < count, itertools.count()):
        rng = np.random.default_rng(seed)
        try:
            scene = random_scene(rng, width=848, height=480, n_objects=n_objects)
        except ConfigError:  # the objects find no place
            continue
        cloud = scene.render(rng, noise_m=0.001).cloud(frame_id="camera_depth_optical_frame")
        if len(Pipeline().segment(cloud).segmentation.objects) >= n_objects:
            clouds.append(cloud)
    return clouds


def check(bench: Bench, clouds: Sequence[Cloud], messages: Sequence[Any]) -> None:
    """One cloud at a time: every answer equals that of the command line, before anything is timed."""
    pipeline = Pipeline()
    for number, (cloud, message) in enumerate(zip(clouds, messages, strict=True)):
        predicted = [one.value for target in pipeline.run(cloud).targets for one in target.predictions]
        expected = [float(np.float32(v)) for touch in predicted for v in touch.values[:2]]
        stamp = bench.send(message)
        bench.wait(lambda stamp=stamp: stamp in bench.answers, 30.0)
        _, values = bench.answers.get(stamp, (0, None))
        if values != expected or not values:
            raise SystemExit(f"cloud {number}: {values} is not {expected}")
    print(f"equal answers: {len(messages)} of {len(messages)} clouds, bit by bit", flush=True)


def measure(rates: Sequence[float], seconds: float) -> list[dict[str, Any]]:
    """A row of the results for each rate, of one start of the graph."""
    clouds, others, rows = scenes(), OthersLoad(), []
    messages = [cloud_to_msg(cloud) for cloud in clouds]
    graph = spawn(NODES, {"diagnostics_period_s": 0.5, "grasp_hold": 0.0, "input": "points"})
    bench = Bench()
    try:
        bench.ready()
        check(bench, clouds, messages)
        before = cpu_s(graph.pid)
        time.sleep(REST_S)
        rest = (cpu_s(graph.pid) - before) / REST_S
        bench.send_at(messages, 10.0, 2.0)  # warm
        for rate in rates:
            before, began = cpu_s(graph.pid), time.monotonic()
            stamps = bench.send_at(messages, rate, seconds)
            cpu = cpu_s(graph.pid) - before - rest * (time.monotonic() - began)
            ages = [(bench.answers[one][0] - one) / 1e6 for one in stamps if bench.answers.get(one, (0, []))[1]]
            p50, p95, p99 = np.percentile(ages, (50, 95, 99))
            row = {"p50_ms": p50, "p95_ms": p95, "p99_ms": p99, "p95_periods": 1e-3 * p95 * len(ages) / seconds,
                   "cpu_ms": 1e3 * cpu / len(ages), "rest_percent": 100.0 * rest}  # fmt: skip
            counts = {"rate_hz": f"{rate:g}", "seconds": seconds, "sent": len(stamps), "lost": len(stamps) - len(ages)}
            rows.append(counts | {name: f"{value:.4g}" for name, value in row.items()})
    finally:
        end(graph)
        bench.leave()
    return [row | {"other_cores": others.cores()} for row in rows]


def write_table(rows: Sequence[dict[str, Any]]) -> None:
    """All runs as a table of the README."""
    most = max((float(row["rate_hz"]) for row in rows if row["lost"] == "0"), default=0.0)
    text = (
        f"The graph in one process answered every 848x480 cloud at up to {most:g} a second ({state(rows)} machine).\n\n"
    )
    columns = ["clouds a second", "lost", "p50, p95, p99 [ms]", "p95 in periods of the answers", "CPU a cloud [ms]"]
    lines = [
        (row["rate_hz"], f"{row['lost']} of {row['sent']}", ", ".join(f"{float(row[key]):.0f}" for key in PERCENTILES),
         f"{float(row['p95_periods']):.1f}", f"{float(row['cpu_ms']):.1f}")
        for row in rows
    ]  # fmt: skip
    replace_marked(Path(__file__).with_name("README.md"), text + markdown(columns, lines))


def state(rows: Sequence[dict[str, Any]]) -> str:
    """Whether others used the machine meanwhile."""
    return "idle" if all(float(row["other_cores"]) < 0.15 for row in rows) else "loaded"


def draw(rows: Sequence[dict[str, Any]]) -> None:
    """Latency and losses of the graph against the rate of the clouds."""
    figure = new_figure(8.0, 5.0)
    top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=[3, 1])
    rates = [float(row["rate_hz"]) for row in rows]
    for key in PERCENTILES:
        top.plot(rates, [float(row[key]) for row in rows], "o-", label=key.removesuffix("_ms"))
    bottom.plot(rates, [100.0 * int(row["lost"]) / int(row["sent"]) for row in rows], "o-", color="black")
    top.set(yscale="log", ylabel=f"stamp of a cloud to its touch [ms],\n{state(rows)} machine")
    top.legend()
    for one in (top.yaxis.set_major_formatter, top.yaxis.set_minor_formatter):
        one("{x:g}")
    bottom.set(xlabel="848x480 clouds a second", ylabel="lost [%]", ylim=(-5.0, 105.0))
    for one in (top, bottom):
        one.grid(which="both", alpha=0.3)
    save_small(figure, PICTURE)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=20.0, help="length of each run [s]")
    parser.add_argument("--rates", type=float, nargs="*", default=RATES, help="clouds a second, in turn [Hz]")
    parser.add_argument("--out", type=Path, default=RESULTS, help="table that is written (default: the committed one)")
    parser.add_argument("--draw", action="store_true", help="only draw the picture and the table from the results")
    parser.add_argument("--requests", type=Path, metavar="CHECKOUT", help="only measure predict_touch, in turns with an older checkout that has an environment of its own")  # fmt: skip
    options = parser.parse_args()
    if options.requests:
        write_csv(REQUESTS, compare(options.requests.resolve(), ROOT, DOMAIN + 1))
        return 0
    prepare_domain(DOMAIN)
    if not options.draw:
        rows = measure(options.rates, options.seconds)
        print_rows(rows)
        write_csv(options.out, rows)
    if options.out == RESULTS:
        draw(read_csv(RESULTS))
        write_table(read_csv(RESULTS))
    return 0


if __name__ == "__main__":
    sys.exit(main())
