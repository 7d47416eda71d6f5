# SPDX-License-Identifier: Apache-2.0
"""Stamp of a cloud -> touch received: stages, processor time, losses, and growth with the load (see README.md)."""

from __future__ import annotations

import argparse
import csv
import itertools
import json
import os
import platform
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

DOMAIN = 87
HERE = Path(__file__).resolve().parent
SOURCES = HERE.parents[1] / "src"
PICTURE = HERE.parents[1] / "docs" / "stamp_to_touch.png"
NODES = ("segmentation", "grasp", "touch_predictor")
FRAME = "camera_depth_optical_frame"
STAGES = (
    "cloud: send, read",
    "wait",
    "segmentation",
    "hand over targets",
    "grasps",
    "hand over grasps",
    "touch",
    "answer: send, read",
)
CPU_COLUMNS = ("segmentation_cpu_ms", "grasps_cpu_ms", "touch_cpu_ms")  # of the core functions, a cloud
SIZES = ((260, 192), (424, 240), (640, 360), (848, 480), (1280, 704))  # 50k to 900k points
COUNTS = {"grasps": (1, 10, 100, 1000), "objects": (1, 2, 5, 10), "cameras": (1, 2, 3, 4)}
_REST_S = 3.0  # without clouds
TICKS = os.sysconf("SC_CLK_TCK")
MARKS = "<!-- results -->\n", "<!-- end of results -->\n"


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=20.0, help="length of each run [s]")
    parser.add_argument(
        "--rates",
        type=float,
        nargs="*",
        default=[30.0, 60.0],
        help="clouds a second [Hz]; 0 sends each when the one before is answered",
    )
    parser.add_argument("--processes", nargs="*", choices=["one", "three"], default=["one", "three"])
    parser.add_argument("--label", default="now", help="name of these rows in the results; rows of that name go")
    parser.add_argument("--source", type=Path, default=SOURCES, help="folder `src` of the nodes, such as of a release")
    parser.add_argument("--model", default="default")
    parser.add_argument("--set", nargs="*", default=[], metavar="NAME:=VALUE", help="parameters of all nodes")
    parser.add_argument("--growth", action="store_true", help="also vary points, grasps, objects and cameras")
    parser.add_argument("--clouds", type=int, default=15, help="clouds of each point of the growth")
    parser.add_argument("--out", type=Path, default=HERE / "results")
    parser.add_argument("--resume", action="store_true", help="keep the rows of this label, and measure the others")
    parser.add_argument("--draw", action="store_true", help="only draw the picture and the table from the results")
    parser.add_argument("--default-profile", action="store_true", help="Fast DDS as it comes")
    return parser.parse_args()


def environment(options: argparse.Namespace) -> None:
    os.environ["ROS_DOMAIN_ID"] = str(DOMAIN)
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    if options.default_profile:
        os.environ["FASTDDS_DEFAULT_PROFILES_FILE"] = ""
    from foretouch.ros.runtime.environment import prepare_environment

    prepare_environment()


class Processes:
    """The nodes of one graph, while the context is open."""

    def __init__(
        self,
        options: argparse.Namespace,
        groups: Iterable[Sequence[str]],
        parameters: Sequence[str] = (),
        space: str = "",
    ) -> None:
        self._folder = tempfile.TemporaryDirectory()
        self.traces = []
        self.children = []
        environ = {**os.environ, "PYTHONPATH": str(options.source)}
        for number, names in enumerate(groups):
            path = Path(self._folder.name) / f"{number}.json"
            given = [
                f"model:={options.model}",
                "diagnostics_period_s:=0.5",
                "grasp_hold:=0.0",
                *options.set,
                *parameters,
            ]
            settings = list(itertools.chain.from_iterable(("-p", one) for one in given))
            settings += ["-r", f"__ns:={space}"] if space else []
            command = [sys.executable, str(HERE / "traced.py"), str(path), *names, "--ros-args", *settings]
            self.children.append(subprocess.Popen(command, env=environ, stderr=subprocess.DEVNULL))
            self.traces.append(path)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        for child in self.children:
            child.send_signal(signal.SIGINT)
        for child in self.children:
            child.wait(20.0)
        self._folder.cleanup()

    def cpu_s(self) -> float:
        """Processor time of all threads so far [s]."""
        return sum(sum(map(int, _stat(child.pid)[11:13])) for child in self.children) / TICKS

    def memory_mb(self) -> float:
        """Largest resident memory, summed over the processes [MB]."""
        texts = [Path(f"/proc/{child.pid}/status").read_text(encoding="utf-8") for child in self.children]
        return sum(int(text.split("VmHWM:")[1].split()[0]) for text in texts) / 1024.0

    def end(self) -> list[dict[str, Any]]:
        """End the processes, and return the rows of their traces."""
        for child in self.children:
            child.send_signal(signal.SIGINT)
        for child in self.children:
            child.wait(20.0)
        return [row for path in self.traces for row in json.loads(path.read_text(encoding="utf-8"))]


def _children_s() -> float:
    """Processor time of the processes that this one has ended [s]."""
    times = os.times()
    return times.children_user + times.children_system


def _stat(pid: int) -> list[str]:
    return Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()


@dataclass
class Bench:
    """Publisher of clouds and subscriber of answers, in this process, for some namespaces."""

    spaces: Sequence[str] = ("/foretouch",)
    received: dict[int, tuple[int, Any]] = field(default_factory=dict)  # by stamp: time of arrival [ns], message
    diagnostics: dict[str, dict[str, str]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        import rclpy
        from diagnostic_msgs.msg import DiagnosticArray
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.qos import QoSProfile, ReliabilityPolicy, qos_profile_sensor_data
        from sensor_msgs.msg import PointCloud2

        from foretouch_msgs.msg import TouchPredictionArray

        if not rclpy.ok():
            rclpy.init()
        self.node = rclpy.create_node("transport_bench", namespace="/foretouch")
        self.publishers = [
            self.node.create_publisher(PointCloud2, f"{space}/points", qos_profile_sensor_data) for space in self.spaces
        ]
        reliable = QoSProfile(depth=100, reliability=ReliabilityPolicy.RELIABLE)
        for space in self.spaces:
            self.node.create_subscription(TouchPredictionArray, f"{space}/touch", self._touch, reliable)
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self._diagnose, 10)
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.node)
        self._thread = threading.Thread(target=self._executor.spin, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Leave the graph."""
        self._executor.shutdown(timeout_sec=1.0)
        self._thread.join(2.0)
        self.node.destroy_node()

    def _touch(self, message: Any) -> None:
        now, stamp = time.time_ns(), message.header.stamp
        self.received[stamp.sec * 10**9 + stamp.nanosec] = now, message

    def _diagnose(self, message: Any) -> None:
        for status in message.status:
            self.diagnostics[status.name] = {pair.key: pair.value for pair in status.values}

    def ready(self, timeout_s: float = 120.0) -> None:
        """Wait until all nodes are active and connected."""
        end = time.monotonic() + timeout_s
        wanted = {"points": 1, "table": 2, "object_cloud": 2, "grasps": 1, "touch": 1}

        def connected() -> bool:
            return all(
                self.node.count_subscribers(f"{space}/{topic}") >= count
                and self.node.count_publishers(f"{space}/{topic}") >= 1
                for space in self.spaces
                for topic, count in wanted.items()
            ) and all(one.get_subscription_count() == 1 for one in self.publishers)

        while not connected():
            if time.monotonic() > end:
                raise SystemExit("the graph does not come up")
            time.sleep(0.1)
        time.sleep(1.5)

    def send(self, message: Any, camera: int = 0) -> int:
        """Publish a cloud with a stamp of this moment, which is returned."""
        stamp = time.time_ns()
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, 10**9)
        self.publishers[camera].publish(message)
        return stamp

    def send_at(self, messages: Sequence[Any], rate_hz: float, seconds: float) -> list[int]:
        """Publish clouds in turn at a rate; 0 for one by one, as many as at 10 Hz."""
        if not rate_hz:
            return self.send_one_by_one(messages, round(10.0 * seconds))
        begin, stamps = time.monotonic(), []
        for number in range(round(rate_hz * seconds)):
            time.sleep(max(0.0, begin + number / rate_hz - time.monotonic()))
            stamps.append(self.send(messages[number % len(messages)]))
        self.wait_for(stamps, 3.0)
        return stamps

    def send_one_by_one(self, messages: Sequence[Any], count: int) -> list[int]:
        """Publish to all cameras at once, the next clouds when all are answered."""
        stamps: list[int] = []
        for number in range(count):
            fresh = [self.send(messages[number % len(messages)], k) for k in range(len(self.publishers))]
            self.wait_for(fresh, 20.0)
            stamps += fresh
            time.sleep(0.005)
        return stamps

    def wait_for(self, stamps: Sequence[int], timeout_s: float) -> None:
        """Wait until clouds are answered, but not for ever."""
        end = time.monotonic() + timeout_s
        while time.monotonic() < end and not all(stamp in self.received for stamp in stamps):
            time.sleep(0.002)


def scenes(width: int, height: int, n_objects: int = 3, count: int = 5) -> list[Any]:
    """Clouds of seeded scenes, with noise and without stamps, that hold a target."""
    import numpy as np

    from foretouch.errors import ConfigError
    from foretouch.pipeline import Pipeline
    from foretouch.simulation.depth_scene import random_scene

    clouds: list[Any] = []
    for seed in range(200):
        rng = np.random.default_rng(seed)
        try:
            scene = random_scene(rng, width=width, height=height, n_objects=n_objects)
        except ConfigError:  # the objects find no place
            continue
        cloud = scene.render(rng, noise_m=0.001).cloud(frame_id=FRAME)
        if len(Pipeline().segment(cloud).segmentation.objects) >= max(1, n_objects if n_objects < 5 else n_objects - 2):
            clouds.append(cloud)
        if len(clouds) == count:
            break
    return clouds


def check(bench: Bench, clouds: Sequence[Any], messages: Sequence[Any], model: str) -> None:
    """One cloud at a time: every answer equals that of the command line, before anything is timed."""
    import numpy as np

    from foretouch.grasp import LiveGeoGraspConfig
    from foretouch.pipeline import Pipeline, PipelineConfig

    pipeline = Pipeline(PipelineConfig(model=model, grasp=LiveGeoGraspConfig()))
    for number, (cloud, message) in enumerate(zip(clouds, messages, strict=True)):
        predicted = [one.value for target in pipeline.run(cloud).targets for one in target.predictions]
        expected = [float(np.float32(v)) for touch in predicted for v in (touch.pdc_th, touch.pdc_mf)]
        stamp = bench.send(message)
        bench.wait_for([stamp], 30.0)
        if stamp not in bench.received:
            raise SystemExit(f"cloud {number}: no answer")
        values = [v for p in bench.received[stamp][1].predictions for v in (p.pdc_th.value, p.pdc_mf.value)]
        if values != expected or not values:
            raise SystemExit(f"cloud {number}: {values} is not {expected}")
    print(f"equal answers: {len(messages)} of {len(messages)} clouds, bit by bit", flush=True)


def stages(trace: Sequence[dict[str, Any]], bench: Bench, stamps: Sequence[int]) -> tuple[Any, Any, Any]:
    """Times of each answered cloud by stage and in total, and its processor time in the core functions of each node.

    Returns:
        (N, 8) float64 of `STAGES`, (N,) float64 from stamp to reception, (3,) float64, median of each node [ms].
    """
    import numpy as np

    by_key = {(row["node"], row["stamp_ns"]): row for row in trace}
    rows, totals, cpu = [], [], []
    for stamp in stamps:
        found = [by_key.get((name, stamp)) for name in NODES]
        if stamp not in bench.received or not bench.received[stamp][1].predictions or None in found:
            continue
        first, second, third = (one for one in found if one is not None)
        end = bench.received[stamp][0]
        rows.append(
            [
                first["received_ns"] - stamp,
                first["began_ns"] - first["received_ns"],
                first["computed_ns"],
                second["began_ns"] - first["began_ns"] - first["computed_ns"],
                second["computed_ns"],
                third["began_ns"] - second["began_ns"] - second["computed_ns"],
                third["computed_ns"],
                end - third["began_ns"] - third["computed_ns"],
            ]
        )
        totals.append(end - stamp)
        cpu.append([one["computed_cpu_ns"] for one in (first, second, third)])
    times, ends, computed = (np.array(values, np.float64) / 1e6 for values in (rows, totals, cpu))
    return times, ends, np.median(computed, axis=0)


def accounts(bench: Bench) -> str:
    """Whether received = used + dropped + waiting in every node, and what was dropped."""
    texts = []
    for name, known in sorted(bench.diagnostics.items()):
        if "received" not in known or name.split("/")[-1] not in NODES:
            continue
        parts = [int(known[key]) for key in ("received", "used", "dropped", "waiting")]
        drops = {k.removeprefix("dropped."): int(v) for k, v in known.items() if k.startswith("dropped.")}
        sign = "=" if parts[0] == sum(parts[1:]) else "IS NOT"
        texts.append(f"  {name}: received {parts[0]} {sign} used {parts[1]} + dropped {drops or 0} + waiting {parts[3]}; "
                     f"lost on the way {known['lost_on_the_way']}")  # fmt: skip
    return "\n".join(texts)


def measure_rates(options: argparse.Namespace, out: Results) -> None:
    """Runs at each rate, in one process and in three."""
    import numpy as np

    from foretouch.ros.messages.clouds import cloud_to_msg
    from foretouch.timing import MachineLoad

    clouds = scenes(848, 480)
    messages = [cloud_to_msg(cloud) for cloud in clouds]
    for kind in options.processes:
        groups = [NODES] if kind == "one" else [(name,) for name in NODES]
        for rate in options.rates:
            if out.has("runs", processes=kind, rate_hz=rate):
                continue
            machine, children, started = MachineLoad(), _children_s(), time.monotonic()
            with Processes(options, groups) as graph:
                bench = Bench()
                bench.ready()
                check(bench, clouds, messages, options.model)
                before = graph.cpu_s()
                time.sleep(_REST_S)
                rest = (graph.cpu_s() - before) / _REST_S
                bench.send_at(messages, 10.0, 2.0)  # warm
                before, began = graph.cpu_s(), time.monotonic()
                stamps = bench.send_at(messages, rate, options.seconds)
                cpu, memory = graph.cpu_s() - before, graph.memory_mb()
                cpu -= rest * (time.monotonic() - began)
                time.sleep(1.2)  # one more round of diagnostics
                answered = sum(1 for s in stamps if s in bench.received and bench.received[s][1].predictions)
                table, totals, computed = stages(graph.end(), bench, stamps)
                own = float(computed.sum())
                bench.close()
            load = machine.row()
            others = max(0.0, float(load["other_cores"]) - (_children_s() - children) / (time.monotonic() - started))
            middle = np.median(table, axis=0)
            p50, p95, p99 = np.percentile(totals, (50, 95, 99))
            row = {"processes": kind, "rate_hz": rate, "seconds": options.seconds, "sent": len(stamps),
                   "answered": answered, "lost": len(stamps) - answered, "p50_ms": p50, "p95_ms": p95, "p99_ms": p99,
                   "cpu_ms": 1e3 * cpu / max(answered, 1), "computation_cpu_ms": own, "rest_percent": 100.0 * rest, "memory_mb": memory,
                   "other_cores": others}  # fmt: skip
            out.add("runs", row)
            for name, median, mean in zip(STAGES, middle, table.mean(axis=0), strict=True):
                out.add(
                    "stages", {"processes": kind, "rate_hz": rate, "stage": name, "p50_ms": median, "mean_ms": mean}
                )
            share = middle.sum() / p50
            print(f"{kind:>5} {rate:3.0f} Hz: sent {len(stamps)}, lost {row['lost']}, p50 {p50:.1f}, p95 {p95:.1f} ms; "
                  f"CPU {row['cpu_ms']:.1f} ms a cloud, of which computation {own:.1f}, and {100.0 * rest:.1f} % of a core at rest; "
                f"{memory:.0f} MB")  # fmt: skip
            print("  " + ", ".join(f"{name} {value:.2f}" for name, value in zip(STAGES, middle, strict=True)))
            print(f"  medians of the stages sum to {share:.3f} of the median total, their means to "
                  f"{table.mean(axis=0).sum() / totals.mean():.3f} of its mean")  # fmt: skip
            print(accounts(bench), flush=True)


def measure_growth(options: argparse.Namespace, out: Results) -> None:
    """One process a graph, clouds one by one: times and processor time against the load."""
    from foretouch.ros.messages.clouds import cloud_to_msg

    for width, height in SIZES:
        grow(options, out, "points", width * height, [cloud_to_msg(one) for one in scenes(width, height)], ())
    usual = [cloud_to_msg(one) for one in scenes(848, 480)]
    for count in COUNTS["grasps"]:
        grow(options, out, "grasps", count, usual, (f"grasp.count:={count}",))
    for count in COUNTS["objects"]:
        messages = [cloud_to_msg(one) for one in scenes(848, 480, count, 3)]
        grow(options, out, "objects", count, messages, ("target.mode:=all",))
    for count in COUNTS["cameras"]:
        grow(options, out, "cameras", count, usual, (), [f"/camera{number}" for number in range(count)])


def grow(
    options: argparse.Namespace,
    out: Results,
    what: str,
    value: int,
    messages: Sequence[Any],
    parameters: Sequence[str],
    spaces: Sequence[str] = ("/foretouch",),
) -> None:
    """Measure one load."""
    import numpy as np

    if out.has("growth", what=what, value=value):
        return

    graphs = [Processes(options, [NODES], parameters, space) for space in spaces]
    try:
        bench = Bench(spaces)
        bench.ready()
        bench.send_one_by_one(messages, len(messages))
        before = sum(one.cpu_s() for one in graphs)
        stamps = bench.send_one_by_one(messages, options.clouds)
        cpu = 1e3 * (sum(one.cpu_s() for one in graphs) - before) / options.clouds
        memory = sum(one.memory_mb() for one in graphs)
        predictions = np.mean([len(bench.received[s][1].predictions) for s in stamps if s in bench.received])
        trace = [row for one in graphs for row in one.end()]
        _, totals, computed = stages(trace, bench, stamps)
        bench.close()
    finally:
        for one in graphs:
            one.__exit__()
    row = {
        "what": what,
        "value": value,
        "predictions": predictions,
        "total_p50_ms": np.median(totals),
        "cpu_ms": cpu,
        **dict(zip(CPU_COLUMNS, computed, strict=True)),
        "memory_mb": memory,
    }
    out.add("growth", row)
    print(" ".join(f"{k} {v:.1f}" if isinstance(v, float) else f"{k} {v}" for k, v in row.items()), flush=True)


def exponents(rows: Sequence[dict[str, str]]) -> list[dict[str, Any]]:
    """Fitted exponents b of time = a load^b by load and quantity, over all loads and over the two largest."""
    import numpy as np

    found = []
    for what in dict.fromkeys(row["what"] for row in rows):
        mine = [row for row in rows if row["what"] == what]
        load = np.log([float(row["value"]) for row in mine])
        for name in ("total_p50_ms", "cpu_ms", *CPU_COLUMNS):
            times = np.log([max(float(row[name]), 1e-3) for row in mine])
            last = (times[-1] - times[-2]) / (load[-1] - load[-2])
            found.append(
                {"what": what, "quantity": name, "exponent": np.polyfit(load, times, 1)[0], "at_the_end": last}
            )
    return found


class Results:
    """CSV files, in which the rows of this label are replaced, or kept if the run is resumed."""

    def __init__(self, folder: Path, label: str, *, resume: bool = False) -> None:
        self._folder, self._label = folder, label
        self._rows: dict[str, list[dict[str, Any]]] = {}
        folder.mkdir(parents=True, exist_ok=True)
        if resume:
            for name in ("runs", "stages", "growth"):
                self._rows[name] = [row for row in self.read(name) if row["label"] == label]

    def has(self, name: str, **key: Any) -> bool:
        """Whether a file has a row of this run with these values."""
        wanted = _plain(key)
        return any(wanted.items() <= row.items() for row in self._rows.get(name, ()))

    def read(self, name: str) -> list[dict[str, str]]:
        """Rows of a file."""
        path = self._folder / f"{name}.csv"
        return list(csv.DictReader(path.open(encoding="utf-8"))) if path.exists() else []

    def add(self, name: str, row: dict[str, Any]) -> None:
        """Add a row to a file, at once."""
        mine = self._rows.setdefault(name, [])
        mine.append({"label": self._label, **_plain(row)})
        kept = [old for old in self.read(name) if old["label"] != self._label]
        with (self._folder / f"{name}.csv").open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, list(mine[-1]), lineterminator="\n")
            writer.writeheader()
            writer.writerows([*kept, *mine])


def _plain(row: dict[str, Any]) -> dict[str, str]:
    return {key: f"{value:.3f}" if isinstance(value, float) else str(value) for key, value in row.items()}


def write_table(results: Results) -> None:
    """All runs as a table of the README."""
    lines = [
        "",
        "| | rate [Hz] | lost | p50, p95 [ms] | CPU a cloud, of which computation [ms] | cores used by others |",
    ]
    lines.append("|---|---|---|---|---|---|")
    for row in results.read("runs"):
        number = {name: float(row[name] or "nan") for name in row if name.endswith(("_ms", "_hz", "_cores"))}
        others = row.get("other_cores")
        lines.append(f"| {row['processes']} process{'es' if row['processes'] == 'three' else ''}, {row['label']} "
                     f"| {number['rate_hz']:.0f} | {row['lost']} of {row['sent']} "
                     f"| {number['p50_ms']:.1f}, {number['p95_ms']:.1f} "
                     f"| {number['cpu_ms']:.1f}, {number['computation_cpu_ms']:.1f} "
                     f"| {number['other_cores'] if others else '–'} |")  # fmt: skip
    readme = HERE / "README.md"
    begin, rest = readme.read_text(encoding="utf-8").split(MARKS[0])
    text = "\n".join([*lines, "", ""])
    readme.write_text(f"{begin}{MARKS[0]}{text}{MARKS[1]}{rest.split(MARKS[1])[1]}", encoding="utf-8")


def draw(results: Results, path: Path) -> None:
    """Stages of each run at 30 Hz, or else at the highest rate, as a bar, with what was lost beside it."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    runs = results.read("runs")
    rates = [float(row["rate_hz"]) for row in runs]
    rate = 30.0 if 30.0 in rates else max(rates)
    runs = [row for row in runs if float(row["rate_hz"]) == rate]
    known = results.read("stages")
    colours = (
        "tab:gray",
        "lightgray",
        "tab:blue",
        "lightsteelblue",
        "tab:green",
        "lightgreen",
        "tab:orange",
        "tab:gray",
    )
    figure, axes = plt.subplots(figsize=(9.0, 1.3 + 0.55 * len(runs)))
    longest = max(float(row["p50_ms"]) for row in runs)
    for place, run in enumerate(runs):
        left = 0.0
        key = [run[name] for name in ("label", "processes", "rate_hz")]
        mine = [one for one in known if [one[name] for name in ("label", "processes", "rate_hz")] == key]
        for one, colour in zip(mine, colours, strict=True):
            width = float(one["p50_ms"])
            label = one["stage"] if place == 0 else None
            axes.barh(place, width, left=left, color=colour, label=label, height=0.62, edgecolor="white", linewidth=0.4)
            left += width
        text = (
            f" p50 {float(run['p50_ms']):.0f}, p95 {float(run['p95_ms']):.0f} ms, {run['lost']} of {run['sent']} lost, "
        )
        axes.text(left + 0.005 * longest, place, text + f"{float(run['cpu_ms']):.0f} ms CPU", va="center", fontsize=8)
    names = {"one": "one process", "three": "three processes"}
    axes.set_yticks(range(len(runs)), [f"{names[run['processes']]}, {run['label']}" for run in runs])
    axes.invert_yaxis()
    axes.set(xlabel=f"from the stamp of an 848x480 cloud to its touch, {rate:.0f} Hz, median of each stage [ms]",
             xlim=(0.0, 1.45 * longest))  # fmt: skip
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(ncols=4, fontsize=8, frameon=False, loc="lower center", bbox_to_anchor=(0.4, 1.0))
    figure.savefig(path, dpi=110, bbox_inches="tight")


def main() -> int:
    options = arguments()
    environment(options)
    results = Results(options.out, options.label, resume=options.resume)
    if not options.draw:
        print(f"{platform.processor() or platform.machine()}, {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}")
        measure_rates(options, results)
        if options.growth:
            measure_growth(options, results)
            mine = [row for row in results.read("growth") if row["label"] == options.label]
            for row in exponents(mine):
                results.add("exponents", row)
    if results.read("runs") and options.out.resolve() == (HERE / "results").resolve():
        draw(results, PICTURE)
        write_table(results)
    return 0


if __name__ == "__main__":
    sys.exit(main())
