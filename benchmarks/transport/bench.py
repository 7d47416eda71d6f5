# SPDX-License-Identifier: Apache-2.0
"""Stamp of a cloud to received touch: stages, processor time and losses (see README.md)."""

import argparse
import json
import os
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Self

import matplotlib as mpl
import numpy as np
from matplotlib import pyplot as plt
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import PointCloud2

from benchmarks.common import ROOT, OthersLoad, markdown, print_rows, read_csv, replace_marked, write_csv
from benchmarks.ros import Client, end, prepare_domain, spawn, stamp_ns, stamped
from foretouch.errors import ConfigError
from foretouch.grasp import LiveGeoGraspConfig
from foretouch.pipeline import Pipeline, PipelineConfig
from foretouch.ros.messages.clouds import cloud_to_msg
from foretouch.simulation.depth_scene import random_scene
from foretouch.types import Cloud
from foretouch_msgs.msg import TouchPredictionArray

DOMAIN = 87
RESULTS = Path(__file__).with_name("results.csv")
PICTURE = ROOT / "docs" / "stamp_to_touch.png"
NODES = ("segmentation", "grasp", "touch_predictor")
FRAME = "camera_depth_optical_frame"
COLOURS = {
    "cloud: send, read": "tab:gray",
    "wait": "lightgray",
    "segmentation": "tab:blue",
    "hand over targets": "lightsteelblue",
    "grasps": "tab:green",
    "hand over grasps": "lightgreen",
    "touch": "tab:orange",
    "answer: send, read": "tab:gray",
}  # of the stages, in order
REST_S = 3.0  # without clouds
TICKS = os.sysconf("SC_CLK_TCK")


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=20.0, help="length of each run [s]")
    parser.add_argument("--rates", type=float, nargs="*", default=[30.0, 60.0], help="clouds a second [Hz]")
    parser.add_argument("--processes", nargs="*", choices=["one", "three"], default=["one", "three"])
    parser.add_argument("--label", default="now", help="name of these rows in the results; older ones of that name go")
    parser.add_argument(
        "--source", type=Path, default=ROOT / "src", help="folder `src` of the nodes, such as that of a release"
    )
    parser.add_argument("--model", default="default")
    parser.add_argument("--set", nargs="*", default=[], metavar="NAME:=VALUE", help="parameters of all nodes")
    parser.add_argument(
        "--out", type=Path, default=RESULTS, help="table to which the rows are added (default: the committed one)"
    )
    parser.add_argument("--draw", action="store_true", help="only draw the picture and the table from the results")
    return parser.parse_args()


class Processes:
    """The nodes of the graph in one process or in three, while the context is open."""

    def __init__(self, options: argparse.Namespace, kind: str) -> None:
        parameters = {"model": options.model, "diagnostics_period_s": 0.5, "grasp_hold": 0.0}
        parameters |= dict(given.split(":=", 1) for given in options.set)
        self._folder = tempfile.TemporaryDirectory()
        self._traces, self._children = [], []
        for number, names in enumerate([NODES] if kind == "one" else [(name,) for name in NODES]):
            self._traces.append(Path(self._folder.name) / f"{number}.json")
            start = ("-m", "benchmarks.transport.traced", str(self._traces[-1]))
            self._children.append(spawn(names, parameters, start=start, source=options.source))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        for child in self._children:
            end(child)
        self._folder.cleanup()

    def cpu_s(self) -> float:
        """Processor time of all threads so far [s]."""
        texts = [Path(f"/proc/{child.pid}/stat").read_text(encoding="utf-8") for child in self._children]
        return sum(sum(map(int, text.rpartition(")")[2].split()[11:13])) for text in texts) / TICKS

    def memory_mb(self) -> float:
        """Largest resident memory, summed over the processes [MB]."""
        texts = [Path(f"/proc/{child.pid}/status").read_text(encoding="utf-8") for child in self._children]
        return sum(int(text.split("VmHWM:")[1].split()[0]) for text in texts) / 1024.0

    def trace(self) -> list[dict[str, Any]]:
        """End the processes, and return the rows of their traces."""
        for child in self._children:
            end(child)
        return [row for path in self._traces for row in json.loads(path.read_text(encoding="utf-8"))]


class Bench(Client):
    """Publisher of clouds and subscriber of answers."""

    def __init__(self) -> None:
        super().__init__("transport_bench", DOMAIN)
        self.answers: dict[int, tuple[int, Any]] = {}  # by stamp: time of arrival [ns], predictions
        self._clouds = self.node.create_publisher(PointCloud2, "points", qos_profile_sensor_data)
        self.node.create_subscription(TouchPredictionArray, "touch", self._hear, self.deep)
        self.serve()

    def ready(self) -> None:
        """Wait until all nodes are active and connected."""
        wanted = {"points": 1, "table": 2, "object_cloud": 2, "grasps": 1, "touch": 1}

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

    def accounts(self) -> str:
        """Whether received = used + dropped + waiting in every node, and what was dropped."""
        texts = []
        for name in NODES:
            known = self.report(name)
            received, *parts = (int(known[key]) for key in ("received", "used", "dropped", "waiting"))
            drops = {key.removeprefix("dropped."): n for key, n in known.items() if key.startswith("dropped.")}
            sign = "=" if received == sum(parts) else "IS NOT"
            texts.append(f"  {name}: received {received} {sign} used {parts[0]} + dropped {drops or 0} + waiting {parts[2]}; "
                         f"lost on the way {known['lost_on_the_way']}")  # fmt: skip
        return "\n".join(texts)

    def _hear(self, message: Any) -> None:
        self.answers[stamp_ns(message.header.stamp)] = time.time_ns(), message.predictions


def scenes(width: int = 848, height: int = 480, n_objects: int = 3, count: int = 5) -> list[Cloud]:
    """Clouds of seeded scenes, with noise and without stamps, in which all objects are found."""
    clouds: list[Cloud] = []
    for seed in range(200):
        rng = np.random.default_rng(seed)
        try:
            scene = random_scene(rng, width=width, height=height, n_objects=n_objects)
        except ConfigError:  # the objects find no place
            continue
        cloud = scene.render(rng, noise_m=0.001).cloud(frame_id=FRAME)
        if len(Pipeline().segment(cloud).segmentation.objects) >= n_objects:
            clouds.append(cloud)
        if len(clouds) == count:
            break
    return clouds


def check(bench: Bench, clouds: Sequence[Cloud], messages: Sequence[Any], model: str) -> None:
    """One cloud at a time: every answer equals that of the command line, before anything is timed."""
    pipeline = Pipeline(PipelineConfig(model=model, grasp=LiveGeoGraspConfig()))
    for number, (cloud, message) in enumerate(zip(clouds, messages, strict=True)):
        predicted = [one.value for target in pipeline.run(cloud).targets for one in target.predictions]
        expected = [float(np.float32(v)) for touch in predicted for v in (touch.pdc_th, touch.pdc_mf)]
        stamp = bench.send(message)
        if not bench.wait(lambda stamp=stamp: stamp in bench.answers, 30.0):
            raise SystemExit(f"cloud {number}: no answer")
        values = [v for one in bench.answers[stamp][1] for v in (one.pdc_th.value, one.pdc_mf.value)]
        if values != expected or not values:
            raise SystemExit(f"cloud {number}: {values} is not {expected}")
    print(f"equal answers: {len(messages)} of {len(messages)} clouds, bit by bit", flush=True)


def stages(trace: Sequence[dict[str, Any]], bench: Bench, stamps: Sequence[int]) -> tuple[Any, Any, float]:
    """Times of each answered cloud by stage and in total, and its processor time in the core functions.

    Returns:
        (N, 8) float64 of the stages, (N,) float64 from stamp to reception, and the sum of the medians of the nodes [ms].
    """
    by_key = {(row["node"], row["stamp_ns"]): row for row in trace}
    rows, totals, cpu = [], [], []
    for stamp in stamps:
        arrived, predictions = bench.answers.get(stamp, (0, ()))
        found = [by_key[name, stamp] for name in NODES if (name, stamp) in by_key]
        if not len(predictions) or len(found) < len(NODES):
            continue
        began, took = ([row[name] for row in found] for name in ("began_ns", "computed_ns"))
        handed = [after - start - work for start, work, after in zip(began, took, [*began[1:], arrived], strict=True)]
        received = found[0]["received_ns"]
        steps = [value for pair in zip(took, handed, strict=True) for value in pair]
        rows.append([received - stamp, began[0] - received, *steps])
        totals.append(arrived - stamp)
        cpu.append([row["computed_cpu_ns"] for row in found])
    times, ends, computed = (np.array(values, np.float64) / 1e6 for values in (rows, totals, cpu))
    return times, ends, float(np.median(computed, axis=0).sum())


def measure(options: argparse.Namespace, kind: str, rate: float, clouds: Sequence[Cloud]) -> dict[str, Any]:
    """One run: a row of the results."""
    messages = [cloud_to_msg(cloud) for cloud in clouds]
    others = OthersLoad()
    with Processes(options, kind) as graph:
        bench = Bench()
        bench.ready()
        check(bench, clouds, messages, options.model)
        before = graph.cpu_s()
        time.sleep(REST_S)
        rest = (graph.cpu_s() - before) / REST_S
        bench.send_at(messages, 10.0, 2.0)  # warm
        before, began = graph.cpu_s(), time.monotonic()
        stamps = bench.send_at(messages, rate, options.seconds)
        cpu, memory = graph.cpu_s() - before, graph.memory_mb()
        cpu -= rest * (time.monotonic() - began)
        time.sleep(1.2)  # one more round of diagnostics
        times, totals, computation = stages(graph.trace(), bench, stamps)
        print(bench.accounts(), flush=True)
        bench.leave()
    answered = sum(len(bench.answers[stamp][1]) > 0 for stamp in stamps if stamp in bench.answers)
    middle = np.median(times, axis=0)
    p50, p95, p99 = np.percentile(totals, (50, 95, 99))
    print(f"  medians of the stages sum to {middle.sum() / p50:.3f} of the median total", flush=True)
    row = {"seconds": options.seconds, "sent": len(stamps), "lost": len(stamps) - answered, "p50_ms": p50,
           "p95_ms": p95, "p99_ms": p99, "cpu_ms": 1e3 * cpu / max(answered, 1), "computation_cpu_ms": computation,
           "rest_percent": 100.0 * rest, "memory_mb": memory, "other_cores": others.cores(),
           **dict(zip(COLOURS, middle, strict=True))}  # fmt: skip
    texts = {name: f"{value:.4g}" if isinstance(value, float) else value for name, value in row.items()}
    return {"label": options.label, "processes": kind, "rate_hz": f"{rate:g}", **texts}


def write_table(rows: Sequence[dict[str, Any]]) -> None:
    """All runs as a table of the README."""
    columns = (
        "",
        "rate [Hz]",
        "lost",
        "p50, p95 [ms]",
        "CPU a cloud, of which computation [ms]",
        "cores used by others",
    )
    lines = [
        (f"{row['processes']} process{'es' if row['processes'] == 'three' else ''}, {row['label']}", row["rate_hz"],
         f"{row['lost']} of {row['sent']}", f"{float(row['p50_ms']):.1f}, {float(row['p95_ms']):.1f}",
         f"{float(row['cpu_ms']):.1f}, {float(row['computation_cpu_ms']):.1f}", row["other_cores"] or "–")
        for row in rows
    ]  # fmt: skip
    replace_marked(Path(__file__).with_name("README.md"), markdown(columns, lines))


def draw(rows: Sequence[dict[str, Any]]) -> None:
    """Stages of each run at 30 Hz as a bar, with what was lost beside it."""
    mpl.use("Agg")
    rows = [row for row in rows if row["rate_hz"] == "30"]
    figure, axes = plt.subplots(figsize=(9.0, 1.3 + 0.55 * len(rows)))
    longest = max(float(row["p50_ms"]) for row in rows)
    lefts = np.zeros(len(rows))
    for name, colour in COLOURS.items():
        widths = np.array([float(row[name]) for row in rows])
        axes.barh(range(len(rows)), widths, 0.62, lefts, color=colour, label=name, edgecolor="white", linewidth=0.4)
        lefts += widths
    for place, row in enumerate(rows):
        text = (
            f" p50 {float(row['p50_ms']):.0f}, p95 {float(row['p95_ms']):.0f} ms, {row['lost']} of {row['sent']} lost"
        )
        text += f", {float(row['cpu_ms']):.0f} ms CPU"
        axes.text(lefts[place] + 0.005 * longest, place, text, va="center", fontsize=8)
    names = {"one": "one process", "three": "three processes"}
    axes.set_yticks(range(len(rows)), [f"{names[row['processes']]}, {row['label']}" for row in rows])
    axes.invert_yaxis()
    axes.set(xlabel="from the stamp of an 848x480 cloud to its touch, 30 Hz, median of each stage [ms]",
             xlim=(0.0, 1.45 * longest))  # fmt: skip
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(ncols=4, fontsize=8, frameon=False, loc="lower center", bbox_to_anchor=(0.4, 1.0))
    figure.savefig(PICTURE, dpi=110, bbox_inches="tight")


def main() -> int:
    options = arguments()
    prepare_domain(DOMAIN)
    if not options.draw:
        clouds = scenes()
        new = [measure(options, kind, rate, clouds) for kind in options.processes for rate in options.rates]
        print_rows([{name: value for name, value in row.items() if name not in COLOURS} for row in new])
        print_rows([{name: row[name] for name in ("processes", "rate_hz", *COLOURS)} for row in new])
        write_csv(options.out, [*(row for row in read_csv(options.out) if row["label"] != options.label), *new])
    if options.out == RESULTS:
        draw(read_csv(RESULTS))
        write_table(read_csv(RESULTS))
    return 0


if __name__ == "__main__":
    sys.exit(main())
