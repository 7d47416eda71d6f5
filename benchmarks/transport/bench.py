# SPDX-License-Identifier: Apache-2.0
"""Cloud published -> touch received, every node in a process of its own (see README.md)."""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import threading
import time
from typing import Any

DOMAIN = 87
NODES = ("segmentation", "grasp", "touch_predictor")
FRAME = "camera_depth_optical_frame"
BASE_NS = 1_700_000_000_000_000_000  # stamps are told apart by their number, times are taken beside them


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--rate", type=float, default=30.0, help="clouds a second")
    parser.add_argument("--width", type=int, default=848)
    parser.add_argument("--height", type=int, default=480)
    parser.add_argument("--scenes", type=int, default=5, help="different clouds, sent in turn")
    parser.add_argument("--model", default="default")
    parser.add_argument("--one-process", action="store_true", help="the three nodes share a process")
    parser.add_argument("--default-profile", action="store_true", help="Fast DDS as it comes")
    return parser.parse_args()


def environment(options: argparse.Namespace) -> None:
    os.environ["ROS_DOMAIN_ID"] = str(DOMAIN)
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    if options.default_profile:
        os.environ["FASTDDS_DEFAULT_PROFILES_FILE"] = ""
    from foretouch.ros.runtime.environment import prepare_environment

    prepare_environment()


def start(options: argparse.Namespace) -> list[subprocess.Popen[bytes]]:
    """The nodes, as processes."""
    processes = []
    for name in ("perception",) if options.one_process else NODES:
        code = f"import sys; from foretouch.ros.executables import {name}; sys.exit({name}())"
        model = ["-p", f"model:={options.model}"] if name in ("perception", "touch_predictor") else []
        command = [sys.executable, "-c", code, "--ros-args", *model, "-p", "diagnostics_period_s:=0.5"]
        processes.append(subprocess.Popen(command))
    return processes


def scenes(options: argparse.Namespace) -> list[Any]:
    """Clouds of seeded scenes, with noise and without stamps, that hold a target."""
    import numpy as np

    from foretouch.pipeline import Pipeline
    from foretouch.simulation.depth_scene import random_scene

    clouds: list[Any] = []
    sizes = []
    for seed in range(100):
        rng = np.random.default_rng(seed)
        scene = random_scene(rng, width=options.width, height=options.height, n_objects=3)
        cloud = scene.render(rng, noise_m=0.001).cloud(frame_id=FRAME)
        targets = Pipeline().segment(cloud).targets
        if targets:
            clouds.append(cloud)
            sizes.append(targets[0].cloud.size)
        if len(clouds) == options.scenes:
            break
    print(f"scenes: {len(clouds)} of {options.width} x {options.height}, targets of {sizes} points")
    return clouds


def expected(clouds: list[Any], options: argparse.Namespace) -> list[list[float]]:
    """What the command line's functions predict for each cloud: PDC of both fingers, of all grasps."""
    import numpy as np

    from foretouch.pipeline import Pipeline, PipelineConfig

    pipeline = Pipeline(PipelineConfig(model=options.model))
    answers = []
    for cloud in clouds:
        values = [p.value for target in pipeline.run(cloud).targets for p in target.predictions]
        answers.append([float(np.float32(v)) for touch in values for v in (touch.pdc_th, touch.pdc_mf)])
    return answers


class Bench:
    """Publisher and subscriber of the measurement, in this process, and the latest diagnostics."""

    def __init__(self) -> None:
        import rclpy
        from diagnostic_msgs.msg import DiagnosticArray
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.qos import QoSProfile, ReliabilityPolicy, qos_profile_sensor_data
        from sensor_msgs.msg import PointCloud2

        from foretouch_msgs.msg import TouchPredictionArray

        rclpy.init()
        self.node = rclpy.create_node("transport_bench", namespace="/foretouch")
        self.publisher = self.node.create_publisher(PointCloud2, "points", qos_profile_sensor_data)
        reliable = QoSProfile(depth=100, reliability=ReliabilityPolicy.RELIABLE)
        self.node.create_subscription(TouchPredictionArray, "touch", self._touch, reliable)
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self._diagnose, 10)
        self.received: dict[int, tuple[float, Any]] = {}
        self.diagnostics: dict[str, dict[str, str]] = {}
        executor = SingleThreadedExecutor()
        executor.add_node(self.node)
        threading.Thread(target=executor.spin, daemon=True).start()

    def _touch(self, message: Any) -> None:
        now = time.monotonic()
        number = message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec - BASE_NS
        self.received[number] = (now, message)

    def _diagnose(self, message: Any) -> None:
        for status in message.status:
            self.diagnostics[status.name] = {pair.key: pair.value for pair in status.values}

    def ready(self, timeout_s: float = 120.0) -> None:
        """Wait until the chain is closed."""
        end = time.monotonic() + timeout_s
        ends = {"points": (1, 1), "table": (1, 2), "object_cloud": (1, 2), "grasps": (1, 1), "touch": (1, 1)}
        while not all(
            self.node.count_publishers(f"/foretouch/{topic}") >= p
            and self.node.count_subscribers(f"/foretouch/{topic}") >= s
            for topic, (p, s) in ends.items()
        ):
            if time.monotonic() > end:
                raise SystemExit("the graph does not come up")
            time.sleep(0.1)
        time.sleep(2.0)

    def send(self, messages: list[Any], count: int, rate_hz: float, first: int) -> dict[int, float]:
        """Publish clouds in turn, each with a stamp of its own."""
        sent = {}
        begin = time.monotonic()
        for k in range(count):
            message = messages[k % len(messages)]
            number = first + k
            message.header.stamp.sec, message.header.stamp.nanosec = divmod(BASE_NS + number, 1_000_000_000)
            time.sleep(max(0.0, begin + k / rate_hz - time.monotonic()))
            sent[number] = time.monotonic()
            self.publisher.publish(message)
        return sent

    def wait_for(self, numbers: Any, timeout_s: float) -> None:
        """Wait until clouds are answered, but not for ever."""
        end = time.monotonic() + timeout_s
        while time.monotonic() < end and not all(number in self.received for number in numbers):
            time.sleep(0.05)


def check(bench: Bench, messages: list[Any], answers: list[list[float]]) -> None:
    """One cloud at a time: every answer equals the command line's."""
    for k, message in enumerate(messages):
        bench.send([message], 1, 1.0, first=k)
        bench.wait_for([k], 30.0)
        if k not in bench.received:
            raise SystemExit(f"cloud {k}: no answer")
        predictions = bench.received[k][1].predictions
        values = [v for p in predictions for v in (p.pdc_th.value, p.pdc_mf.value)]
        if values != answers[k] or not values:
            raise SystemExit(f"cloud {k}: {values} is not {answers[k]}")
    print(f"equal answers: {len(messages)} of {len(messages)} clouds, bit by bit")


def report(bench: Bench, sent: dict[int, float]) -> None:
    """The two tables."""
    import numpy as np

    good = [n for n in sent if n in bench.received and bench.received[n][1].predictions]
    latency = np.array([bench.received[n][0] - sent[n] for n in good]) * 1e3
    span = max(sent.values()) - min(sent.values())
    print(f"\n{'sent':>8} {'received':>8} {'rate Hz':>8} {'p50 ms':>8} {'p95 ms':>8} {'max ms':>8}")
    times = np.percentile(latency, [50, 95, 100]) if len(latency) else [float("nan")] * 3
    print(f"{len(sent):8d} {len(good):8d} {(len(sent) - 1) / span:8.2f} " + " ".join(f"{t:8.1f}" for t in times))
    print(f"\n{'node':<28} {'received':>8} {'used':>8} {'lost':>6} {'p50 ms':>8} {'p95 ms':>8}  dropped")
    for name, known in sorted(bench.diagnostics.items()):
        drops = {k.removeprefix("dropped."): v for k, v in known.items() if k.startswith("dropped.")}
        print(
            f"{name:<28} {known['received']:>8} {known['used']:>8} {known['lost_on_the_way']:>6} "
            f"{known.get('latency_ms.p50', '-'):>8} {known.get('latency_ms.p95', '-'):>8}  {drops or 'none'}"
        )


def main() -> int:
    options = arguments()
    environment(options)
    from foretouch.ros.messages.clouds import cloud_to_msg

    processes = start(options)
    try:
        clouds = scenes(options)
        messages = [cloud_to_msg(cloud) for cloud in clouds]
        answers = expected(clouds, options)
        bench = Bench()
        bench.ready()
        check(bench, messages, answers)
        count = round(options.seconds * options.rate)
        sent = bench.send(messages, count, options.rate, first=1000)
        bench.wait_for(sent, 5.0)
        time.sleep(1.0)  # one more round of diagnostics
        report(bench, sent)
        return 0 if all(n in bench.received for n in sent) else 1
    finally:
        for process in processes:
            process.send_signal(signal.SIGINT)
        for process in processes:
            _, _, usage = os.wait4(process.pid, 0)
            print(f"{process.args[2].split()[-1]:<28} {usage.ru_utime + usage.ru_stime:8.1f} s of CPU, start included")


if __name__ == "__main__":
    sys.exit(main())
