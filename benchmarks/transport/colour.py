# SPDX-License-Identifier: Apache-2.0
"""Processor time of an answer to a depth image with and without aligned colours beside it, in turns, and what is lost at a rate (see README.md)."""

import argparse
import itertools
import time
from collections.abc import Sequence
from typing import Any

import numpy as np
from sensor_msgs.msg import Image, PointCloud2

from benchmarks.ros import end, spawn, stamped
from benchmarks.transport.bench import NOW, Bench, Condition, scenes
from benchmarks.transport.outputs import burst
from foretouch.ros.messages.clouds import colours_to_msg, depth_to_msgs

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
    parser.add_argument("--turns", type=int, default=20)
    parser.add_argument("--seconds", type=float, default=10.0, help="length of the run at a rate [s]")
    parser.add_argument("--rate", type=float, default=30.0, help="images a second in that run [Hz]")
    options = parser.parse_args()
    bench = ColourBench()
    graph = spawn(NOW, {"diagnostics_period_s": 0.5, "grasp_hold": 0.0})
    inputs = [depth_to_msgs(frame)[::-1] for frame in scenes()]
    rng = np.random.default_rng(0)
    for info, depth in inputs:
        pixels = rng.integers(0, 256, (depth.height, depth.width, 3), np.uint8)
        bench.images.append(colours_to_msg(info.header, pixels))
    costs: dict[tuple[bool, bool], list[float]] = {}
    try:
        bench.ready()
        burst(bench, graph.pid, inputs, 20)
        for looked_at in (False, True):
            if looked_at:
                bench.node.create_subscription(PointCloud2, "object_cloud", lambda _: None, 10)
                bench.wait(lambda: bench.colours.get_subscription_count() > 0, 10.0)
                time.sleep(1.0)
            for _, bench.coloured in itertools.product(range(options.turns), (False, True)):
                costs.setdefault((looked_at, bench.coloured), []).append(burst(bench, graph.pid, inputs, 10))
        for looked_at, who in ((False, "nobody looks at them"), (True, "object_cloud has a subscriber")):
            off, on = (1e3 * float(np.median(costs[looked_at, coloured])) for coloured in (False, True))
            print(f"colours beside depth, {who}: {off:.2f} ms without, {on:.2f} ms with: {on / off:.3f}")
        for bench.coloured in (False, True):
            bench.received()
            before = dict(bench.report(NOW[0]))
            stamps = bench.send_at(inputs, options.rate, options.seconds)
            bench.received()
            after = bench.report(NOW[0])
            counts = (f"{name} {int(after.get(name, 0)) - int(before.get(name, 0))}" for name in COUNTS)
            who = "depth and colours" if bench.coloured else "depth alone"
            print(f"{who} at {options.rate:g} Hz: sent {len(stamps)}, {', '.join(counts)}")
    finally:
        end(graph)
        bench.leave()


if __name__ == "__main__":
    main()
