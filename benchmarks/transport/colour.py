# SPDX-License-Identifier: Apache-2.0
"""Processor time of an answer to depth images at 30 Hz with and without aligned colours beside them, in turns (see README.md)."""

import argparse
import itertools
import time
from collections.abc import Sequence
from typing import Any

import numpy as np
from sensor_msgs.msg import Image, PointCloud2

from benchmarks.ros import end, spawn, stamped
from benchmarks.transport.bench import NOW, Bench, Condition, scenes
from benchmarks.transport.outputs import cpu_s
from foretouch.ros.messages.clouds import colours_to_msg, depth_to_msgs

RATE_HZ = 30.0
COUNTS = ("received", "used", "lost_on_the_way", "color.received", "color.paired", "color.unpaired", "color.refused")


class ColourBench(Bench):
    """Sends depth images, while `coloured` each behind its colours, as a driver does."""

    def __init__(self) -> None:
        self.coloured = True
        self.images: list[Image] = []
        super().__init__(Condition("now", "depth", "profile"))
        self._sent = itertools.count()
        self.colours = self.node.create_publisher(Image, "color/image", 10)

    def send(self, messages: Sequence[Any]) -> int:
        """Publish an image after its info and its colours, with a stamp of this moment, which is returned [ns]."""
        if not self.coloured:
            return super().send(messages)
        image = self.images[next(self._sent) % len(self.images)]
        stamp = stamped(*messages, image)
        self.colours.publish(image)
        for publisher, message in zip(self._publishers, messages, strict=True):
            publisher.publish(message)
        return stamp


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--turns", type=int, default=5)
    parser.add_argument("--seconds", type=float, default=5.0, help="length of each run [s]")
    options = parser.parse_args()
    bench = ColourBench()
    graph = spawn(NOW, {"diagnostics_period_s": 0.5, "grasp_hold": 0.0})
    inputs = [depth_to_msgs(frame)[::-1] for frame in scenes()]
    rng = np.random.default_rng(0)
    for info, depth in inputs:
        pixels = rng.integers(0, 256, (depth.height, depth.width, 3), np.uint8)
        bench.images.append(colours_to_msg(info.header, pixels))
    costs: dict[tuple[bool, bool], list[float]] = {}
    unanswered = 0
    try:
        bench.ready()
        bench.wait(lambda: bench.colours.get_subscription_count() > 0, 10.0)
        bench.send_at(inputs, RATE_HZ, 2.0)
        for looked_at in (False, True):
            if looked_at:
                bench.node.create_subscription(PointCloud2, "object_cloud", lambda _: None, 10)
                time.sleep(3.0)
            for _, bench.coloured in itertools.product(range(options.turns), (False, True)):
                before = cpu_s(graph.pid)
                stamps = bench.send_at(inputs, RATE_HZ, options.seconds)
                answered = sum(stamp in bench.answers for stamp in stamps)
                costs.setdefault((looked_at, bench.coloured), []).append((cpu_s(graph.pid) - before) / max(1, answered))
                unanswered += len(stamps) - answered
        bench.received()
        report = bench.report(NOW[0])
        print(", ".join(f"{name} {report.get(name, 0)}" for name in COUNTS), f"unanswered {unanswered}", sep=", ")
        for looked_at, who in ((False, "nobody looks at them"), (True, "object_cloud has a subscriber")):
            off, on = (1e3 * float(np.median(costs[looked_at, coloured])) for coloured in (False, True))
            print(f"colours beside depth, {who}: {off:.2f} ms without, {on:.2f} ms with: {on / off:.3f}")
    finally:
        end(graph)
        bench.leave()


if __name__ == "__main__":
    main()
