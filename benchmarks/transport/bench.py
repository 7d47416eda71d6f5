# SPDX-License-Identifier: Apache-2.0
"""Stamp of an image or a cloud to received touch, by input, transport and version: latency, processor time and losses (see README.md)."""

import argparse
import itertools
import multiprocessing
import os
import subprocess
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import CameraInfo, Image, PointCloud2

from benchmarks.common import ROOT, markdown, print_rows, read_csv, replace_marked, write_csv
from benchmarks.random_scenes import random_scene
from benchmarks.ros import Client, end, prepare_domain, spawn, stamp_ns, stamped
from benchmarks.transport.round_trip import compare
from foretouch.camera.stream import DepthFrame
from foretouch.errors import ConfigError
from foretouch.pipeline import Pipeline
from foretouch.ros.messages.clouds import cloud_to_msg, depth_to_msgs
from foretouch.ros.runtime.environment import profile_variable
from foretouch.types import CameraModel, Cloud
from foretouch_lab.experiments.framework.timing import MachineLoad
from foretouch_msgs.msg import TouchPredictionArray

DOMAIN = 87
RESULTS = Path(__file__).with_name("results.csv")
REQUESTS = Path(__file__).with_name("requests.csv")
NOW, BEFORE = ("perception",), ("segmentation", "grasp", "touch_predictor")  # the nodes of both versions
PROFILES = ("FASTDDS_DEFAULT_PROFILES_FILE", "FASTRTPS_DEFAULT_PROFILES_FILE")
TOPICS = {"depth": "depth/image", "points": "points"}
RATES = [30.0, 90.0]
REST_S = 2.0  # without input


class Condition(NamedTuple):
    """What is compared."""

    version: str  # now, or before: clouds only
    input: str  # depth or points
    transport: str  # profile: our shared memory on both sides; shipped: Fast DDS as it is


def cpu_s(pid: int) -> float:
    """Return the processor time of all threads of a process so far [s]."""
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
    return sum(map(int, fields[11:13])) / os.sysconf("SC_CLK_TCK")


class Bench(Client):
    """Publisher of images or clouds, reliable as realsense2_camera's, and subscriber of answers."""

    def __init__(self, condition: Condition) -> None:
        super().__init__("transport_bench", DOMAIN)
        self.answers: dict[int, tuple[int, list[float]]] = {}  # by stamp: time of arrival [ns], predicted pressures
        self._topic, self._nodes = TOPICS[condition.input], NOW if condition.version == "now" else BEFORE
        kinds = {"depth/image": Image, "depth/camera_info": CameraInfo, "points": PointCloud2}
        names = {"depth": ("depth/camera_info", "depth/image"), "points": ("points",)}[condition.input]
        reliable = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)
        self._publishers = [self.node.create_publisher(kinds[name], name, reliable) for name in names]
        self.node.create_subscription(TouchPredictionArray, "touch", self._hear, self.deep)
        self.serve()

    def ready(self) -> None:
        """Wait until all nodes are active and connected."""

        def connected() -> bool:
            return (
                self.is_active(self._nodes)
                and all(publisher.get_subscription_count() for publisher in self._publishers)
                and self.node.count_publishers("touch") >= 1
            )

        if not self.wait(connected, 120.0):
            raise SystemExit("the graph does not come up")
        time.sleep(1.5)

    def send(self, messages: Sequence[Any]) -> int:
        """Publish an image after its info, or a cloud, with a stamp of this moment, which is returned [ns]."""
        stamp = stamped(*messages)
        for publisher, message in zip(self._publishers, messages, strict=True):
            publisher.publish(message)
        return stamp

    def send_at(self, inputs: Sequence[Sequence[Any]], rate_hz: float, seconds: float) -> list[int]:
        """Publish inputs in turn at a rate; returns their stamps [ns]."""
        begin, stamps = time.monotonic(), []
        for number in range(round(rate_hz * seconds)):
            time.sleep(max(0.0, begin + number / rate_hz - time.monotonic()))
            stamps.append(self.send(inputs[number % len(inputs)]))
        self.wait(lambda: all(stamp in self.answers for stamp in stamps), 3.0)
        return stamps

    def received(self) -> int:
        """Return the number of images or clouds that the first node has received so far, by a report that is newer than all of them."""
        now = time.monotonic()
        self.wait(lambda: self.reported_at(self._nodes[0]) > now + 0.1, 5.0)  # at least a callback later
        return int(self.report(self._nodes[0])["received"])

    def _hear(self, message: Any) -> None:
        arrived = time.time_ns()  # whole messages of ten minutes would take gigabytes
        values = [value for touch in message.predictions for value in touch.scalars]
        self.answers[stamp_ns(message.header.stamp)] = arrived, values


def scenes(n_objects: int = 3, count: int = 5) -> list[DepthFrame]:
    """Return depth images (480, 848) of seeded scenes, with noise and without stamps, in which all objects are found."""
    frames: list[DepthFrame] = []
    for seed in itertools.takewhile(lambda _: len(frames) < count, itertools.count()):
        rng = np.random.default_rng(seed)
        try:
            scene = random_scene(rng, width=848, height=480, n_objects=n_objects)
        except ConfigError:  # the objects find no place
            continue
        k = scene.view.matrix
        camera = CameraModel(848, 480, float(k[0, 0]), float(k[1, 1]), float(k[0, 2]), float(k[1, 2]))
        depth = scene.render(rng, noise_m=0.001).depth_mm
        frame = DepthFrame(depth, 0.001, camera, "camera_depth_optical_frame", 0)
        if len(Pipeline().segment(frame.cloud()).objects) >= n_objects:
            frames.append(frame)
    return frames


def check(bench: Bench, clouds: Sequence[Cloud], inputs: Sequence[Sequence[Any]]) -> None:
    """One input at a time: every answer equals that of `Pipeline.run`, before anything is timed."""
    pipeline = Pipeline()
    for number, (cloud, messages) in enumerate(zip(clouds, inputs, strict=True)):
        predicted = [prediction.value for target in pipeline.run(cloud).targets for prediction in target.predictions]
        expected = [float(np.float32(v)) for touch in predicted for v in touch.values[:2]]
        values: list[float] = []
        for _ in range(5):  # a transport may lose some
            stamp = bench.send(messages)
            if bench.wait(partial(bench.answers.__contains__, stamp), 5.0):
                _, values = bench.answers[stamp]
                break
        if values != expected or not values:
            raise SystemExit(f"input {number}: {values} is not {expected}")


def measure(
    condition: Condition, source: Path, rates: Sequence[float], seconds: float, busy: int
) -> list[dict[str, Any]]:
    """Return a row of the results for each rate, of one start of a version's graph, whose checkout is `source`; in a process alone.

    Beside it, `busy` processes compute.
    """
    if condition.transport == "shipped":
        ignored = PROFILES[profile_variable() == PROFILES[0]]  # by this release of Fast DDS
        os.environ[ignored] = ""  # so that neither version names its profile
    prepare_domain(DOMAIN)
    os.environ["PYTHONPATH"] = str(source / "src")  # of the graph
    frames = scenes()
    load = MachineLoad()
    rows = []
    clouds = [frame.cloud() for frame in frames]
    inputs: list[tuple[Any, ...]] = [depth_to_msgs(frame)[::-1] for frame in frames]
    if condition.input == "points":
        clouds = [Cloud(cloud.xyz, frame_id=cloud.frame_id) for cloud in clouds]  # whose image and camera are not known
        inputs = [(cloud_to_msg(cloud),) for cloud in clouds]
    now = condition.version == "now"
    parameters = {"diagnostics_period_s": 0.5, "grasp_hold": 0.0} | ({"input": condition.input} if now else {})
    graph = spawn(NOW if now else BEFORE, parameters)
    beside = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(busy)]
    bench = Bench(condition)
    try:
        bench.ready()
        if now:
            check(bench, clouds, inputs)
        before = cpu_s(graph.pid)
        time.sleep(REST_S)
        rest = (cpu_s(graph.pid) - before) / REST_S
        bench.send_at(inputs, 10.0, 1.0)  # warm
        for rate in rates:
            received = bench.received()
            before, began = cpu_s(graph.pid), time.monotonic()
            stamps = bench.send_at(inputs, rate, seconds)
            cpu = cpu_s(graph.pid) - before - rest * (time.monotonic() - began)
            lost = len(stamps) - (bench.received() - received)
            ages = [(bench.answers[stamp][0] - stamp) / 1e6 for stamp in stamps if bench.answers.get(stamp, (0, []))[1]]
            p50, p95 = np.percentile(ages, (50, 95)) if ages else (np.nan, np.nan)
            counts = {
                "rate_hz": f"{rate:g}",
                "seconds": f"{seconds:g}",
                "sent": len(stamps),
                "lost": lost,
                "superseded": len(stamps) - lost - len(ages),
            }
            times = {
                "p50_ms": p50,
                "p95_ms": p95,
                "cpu_ms": 1e3 * cpu / max(1, len(ages)),
                "rest_percent": 100.0 * rest,
            }
            rows.append(condition._asdict() | counts | {name: f"{value:.4g}" for name, value in times.items()})
    finally:
        for process in (graph, *beside):
            end(process)
        bench.leave()
    return [{"busy": busy} | row | {"other_cores": load.row()["other_cores"]} for row in rows]


def in_turns(
    before: Path | None, rates: Sequence[float], seconds: float, turns: int, busy: int
) -> list[dict[str, Any]]:
    """Measure all inputs, transports and versions one after the other, `turns` times."""
    conditions = [Condition(*parts) for parts in itertools.product(["now"], TOPICS, ["profile", "shipped"])]
    if before:
        conditions += [Condition("before", "points", transport) for transport in ("profile", "shipped")]
    rows = []
    for turn, condition in itertools.product(
        range(turns), sorted(conditions, key=lambda condition: condition.transport)
    ):
        source = before if before and condition.version == "before" else ROOT
        with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as alone:  # Fast DDS reads its profile once
            measured = alone.submit(measure, condition, source, rates, seconds, busy).result()
        rows += [{"turn": turn + 1} | row for row in measured]
        print_rows(rows[-len(measured) :])
    return rows


def write_table(rows: Sequence[dict[str, Any]]) -> None:
    """All conditions as a table of the README: what was lost and superseded in all turns, and the median of the turns' times."""
    columns = [
        "a second",
        "busy",
        "input",
        "transport",
        "version",
        "sent",
        "lost",
        "superseded",
        "p50, p95 [ms]",
        "CPU an answer [ms]",
    ]
    cells: dict[tuple[str, ...], list[dict[str, Any]]] = {}
    for row in rows:
        cells.setdefault(tuple(row[key] for key in ("rate_hz", "busy", "input", "transport", "version")), []).append(
            row
        )
    lines = []
    for key, group in sorted(cells.items(), key=lambda cell: (float(cell[0][0]), *cell[0][1:])):
        p50, p95, cpu = (np.median([float(row[name]) for row in group]) for name in ("p50_ms", "p95_ms", "cpu_ms"))
        counts = [sum(int(row[name]) for row in group) for name in ("sent", "lost", "superseded")]
        lines.append((*key, *counts, f"{p50:.1f}, {p95:.1f}", f"{cpu:.1f}"))
    others = [float(row["other_cores"]) for row in rows]
    load = f"Other processes used {min(others):.2f} to {max(others):.2f} of {os.cpu_count()} cores meanwhile.\n\n"
    replace_marked(Path(__file__).with_name("README.md"), load + markdown(columns, lines))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--before",
        type=Path,
        metavar="CHECKOUT",
        help="version of 0.3 whose kernels are built, measured in turns with this one",
    )
    parser.add_argument("--seconds", type=float, default=5.0, help="length of each run [s]")
    parser.add_argument("--rates", type=float, nargs="*", default=RATES, help="inputs a second, in turn [Hz]")
    parser.add_argument("--turns", type=int, default=1, help="how often all is measured")
    parser.add_argument("--busy", type=int, default=0, metavar="N", help="processes that compute meanwhile")
    parser.add_argument("--add", action="store_true", help="keep the rows that the table has already")
    parser.add_argument(
        "--out", type=Path, default=RESULTS, help="table that is written (default: the committed one, and the page)"
    )
    parser.add_argument(
        "--requests",
        type=Path,
        metavar="CHECKOUT",
        help="only measure predict_touch, in turns with an older checkout that has an environment of its own",
    )
    options = parser.parse_args()
    if options.requests:
        write_csv(REQUESTS, compare(options.requests.resolve(), ROOT, DOMAIN + 1))
        return 0
    rows = in_turns(
        options.before and options.before.resolve(), options.rates, options.seconds, options.turns, options.busy
    )
    write_csv(options.out, [*(read_csv(options.out) if options.add else []), *rows])
    if options.out == RESULTS:
        write_table(read_csv(RESULTS))
    return 0


if __name__ == "__main__":
    sys.exit(main())
