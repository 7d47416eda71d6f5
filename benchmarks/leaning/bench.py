# SPDX-License-Identifier: Apache-2.0
"""What does it cost the touch predictor to lean on the hand? CPU time, medians, the model alone in the same run.

python benchmarks/leaning/bench.py [--model default] [--rounds 200] [--points 3000]
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from collections.abc import Callable

import numpy as np

from foretouch.ros.environment import prepare_environment

prepare_environment()

from foretouch.dataset.pairing import Interval, TouchBuffer, TouchReading, cut_touch  # noqa: E402
from foretouch.models import load_model  # noqa: E402
from foretouch.models.touch_memory import TouchMemory  # noqa: E402
from foretouch.pipeline import ASSUMED_TABLE, FoundObject  # noqa: E402
from foretouch.ros.clouds import objects_from_msg, objects_to_msg  # noqa: E402
from foretouch.ros.conversions import grasp_to_msg, header_to_msg, stamp_to_msg  # noqa: E402
from foretouch.ros.feeling import Feeling  # noqa: E402
from foretouch.ros.tactile_adapters import AdapterConfig, make_adapter  # noqa: E402
from foretouch.ros.tactile_messages import biotac_all_to_msg  # noqa: E402
from foretouch.ros.touch_predictor_config import TouchPredictorConfig  # noqa: E402
from foretouch.types import Cloud, Grasp  # noqa: E402
from foretouch_msgs.msg import ExecutedGrasp  # noqa: E402

PERIOD_NS = 10_000_000
FRAME = "camera"
REST = np.concatenate([[2779.0, 1676.0], np.linspace(3000.0, 3300.0, 24), np.linspace(3100.0, 3500.0, 24)])
HELD = REST + np.concatenate([[120.0, 120.0], np.full(48, -70.0)])
LOAD = """
import time
from foretouch.models import load_model
began = time.perf_counter()
load_model({!r})
print(time.perf_counter() - began)
"""


class Hand:
    """Sends readings straight into the callback, and times it."""

    def __init__(self, feeling: Feeling, clock: list[int]) -> None:
        self.feeling, self.clock = feeling, clock
        self.times: list[float] = []
        self.buffer = TouchBuffer()
        self._rng = np.random.default_rng(0)

    def feel(self, counts: np.ndarray, readings: int) -> None:
        """So many readings at 100 Hz."""
        for _ in range(readings):
            noisy = np.round(counts + self._rng.normal(0.0, np.r_[0.3, 0.3, np.full(48, 4.0)])).astype(np.int16)
            fingers = {"TH": np.r_[noisy[0], noisy[2:26]], "MF": np.r_[noisy[1], noisy[26:]]}
            message = biotac_all_to_msg(fingers, "rh", self.clock[0])
            began = time.process_time()
            self.feeling.take_tactile(message)
            self.times.append(time.process_time() - began)
            self.buffer.add(
                TouchReading(self.clock[0], noisy.astype(np.float32), np.empty(0, np.float32), self.clock[0])
            )
            self.clock[0] += PERIOD_NS

    def execute(self, grasp_id: str) -> Interval:
        """Close, hold for half a second, open, and tell of it."""
        times = {}
        for name, counts, readings in (("start", REST, 10), ("contact", HELD, 50), ("release", REST, 20)):
            times[name] = self.clock[0]
            self.feel(counts, readings)
        stamps = {name: stamp_to_msg(stamp) for name, stamp in times.items()}
        header = header_to_msg(FRAME, self.clock[0])
        self.feeling.take_executed(ExecutedGrasp(header=header, grasp_id=grasp_id, success=True, **stamps))
        return Interval(**times)


def median_ms(work: Callable[[], object], rounds: int) -> float:
    """Median CPU time [ms]."""
    times = []
    for _ in range(rounds):
        began = time.process_time()
        work()
        times.append(time.process_time() - began)
    return 1e3 * float(np.median(times))


def main() -> None:
    """Prove equal answers, then time."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--model", default="default")
    parser.add_argument("--rounds", type=int, default=200)
    parser.add_argument("--points", type=int, default=3000)
    arguments = parser.parse_args()
    model, clock, settings = load_model(arguments.model), [time.time_ns()], TouchPredictorConfig()
    feeling = Feeling(model, make_adapter(AdapterConfig()), lambda: settings, lambda: clock[0], print)
    hand = Hand(feeling, clock)

    rng = np.random.default_rng(1)
    angle, along = rng.uniform(0, np.pi, arguments.points), rng.uniform(-0.05, 0.05, arguments.points)
    can = np.column_stack([0.033 * np.cos(angle), along, 1.2 - 0.033 * np.sin(angle)]).astype(np.float32)
    grasp = Grasp(np.array([0.033, 0.0, 1.2]), np.array([-0.033, 0.0, 1.2]), np.eye(3), 1.0, "g", "1")
    message = objects_to_msg([FoundObject("1", Cloud(can), ASSUMED_TABLE)], FRAME, clock[0])
    (target,) = objects_from_msg(message, ASSUMED_TABLE)
    cloud, planned = target.cloud, [grasp_to_msg(grasp)]

    hand.feel(REST, 300)
    figures = {"model alone": median_ms(lambda: model.predict(cloud, [grasp]), arguments.rounds)}
    figures["with a tare"] = median_ms(lambda: feeling.predict(cloud, [grasp]), arguments.rounds)
    copies = iter([objects_to_msg([target], FRAME, clock[0] - k) for k in range(20, -1, -1)])
    figures["keep a cloud"] = median_ms(lambda: feeling.see(next(copies), FRAME, planned), 20)
    feeling.forget()
    feeling.see(message, FRAME, planned)

    interval = hand.execute("g")
    figures["learn a touch, once"] = median_ms(feeling.settle, 1)
    cut = cut_touch(hand.buffer, interval, settings.pairing)
    memory = TouchMemory(model, cut.tare)
    memory.add(cloud, grasp, cut.touch)
    core, mine = model.predict(cloud, [grasp], memory=memory)[0], feeling.predict(cloud, [grasp])[0]
    if core.value is None or mine.value is None or not np.array_equal(core.value.vector(), mine.value.vector()):
        raise SystemExit(f"the answer is not the core's: {feeling.notes()}")
    figures["with a touch"] = median_ms(lambda: feeling.predict(cloud, [grasp]), arguments.rounds)

    print(f"{model.name}, {arguments.points} points, one grasp; answers equal the core's. CPU time, median [ms]:")
    for name, cost in figures.items():
        print(f"  {name:22} {cost:7.3f}")
    print(f"  {'a tactile message':22} {1e3 * np.median(hand.times):7.3f} (mean {1e3 * np.mean(hand.times):.3f})")
    command = [sys.executable, "-c", LOAD.format(arguments.model)]
    loads = [float(subprocess.run(command, capture_output=True, check=True).stdout) for _ in range(5)]
    print(f"  load in a fresh process: {np.median(loads):.3f} s (wall, median of 5)")


if __name__ == "__main__":
    main()
