# SPDX-License-Identifier: Apache-2.0
"""What does online adaptation cost the touch predictor? CPU time, medians, the model alone in the same run.

python benchmarks/adaptation/bench.py [--model default] [--rounds 200] [--points 3000]
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np

from foretouch.ros.runtime.environment import prepare_environment

prepare_environment()

from foretouch.dataset.pairing import Interval, TouchBuffer, TouchReading, cut_touch  # noqa: E402
from foretouch.models import load_model  # noqa: E402
from foretouch.models.hand_history import HandHistory  # noqa: E402
from foretouch.models.touch_model import TouchModel  # noqa: E402
from foretouch.pipeline import FoundObject  # noqa: E402
from foretouch.ros.messages.clouds import objects_from_msg, objects_to_msg  # noqa: E402
from foretouch.ros.messages.conversions import grasp_to_msg, header_to_msg, stamp_to_msg  # noqa: E402
from foretouch.ros.messages.tactile import biotac_all_to_msg  # noqa: E402
from foretouch.ros.touch.config import TouchPredictorConfig  # noqa: E402
from foretouch.ros.touch.online_adapter import OnlineAdapter  # noqa: E402
from foretouch.tactile.messages import TactileConfig, make_reader  # noqa: E402
from foretouch.types import ASSUMED_TABLE, Cloud, Grasp, TouchPrediction  # noqa: E402
from foretouch_msgs.msg import ExecutedGrasp  # noqa: E402

PERIOD_NS = 10_000_000
FRAME = "camera"
G1, G2 = (0.033, 0.0, 1.2), (-0.033, 0.0, 1.2)  # contacts [m]
TOUCHES = 20
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
    """Calls the callback with readings, and times it."""

    def __init__(self, adapter: OnlineAdapter, clock: list[int]) -> None:
        self.adapter, self.clock = adapter, clock
        self.times: list[float] = []
        self.buffer = TouchBuffer()
        self._rng = np.random.default_rng(0)

    def send(self, counts: np.ndarray, readings: int) -> None:
        """This number of readings at 100 Hz."""
        for _ in range(readings):
            noisy = np.round(counts + self._rng.normal(0.0, np.r_[0.3, 0.3, np.full(48, 4.0)])).astype(np.int16)
            fingers = {"TH": np.r_[noisy[0], noisy[2:26]], "MF": np.r_[noisy[1], noisy[26:]]}
            message = biotac_all_to_msg(fingers, "rh", self.clock[0])
            began = time.process_time()
            self.adapter.add_tactile(message)
            self.times.append(time.process_time() - began)
            self.buffer.add(
                TouchReading(self.clock[0], noisy.astype(np.float32), np.empty(0, np.float32), self.clock[0])
            )
            self.clock[0] += PERIOD_NS

    def execute(self, grasp_id: str) -> Interval:
        """Rest, close, hold for half a second, open, and report the executed grasp."""
        self.send(REST, 100)
        times = {}
        for name, counts, readings in (("start", REST, 10), ("contact", HELD, 50), ("release", REST, 20)):
            times[name] = self.clock[0]
            self.send(counts, readings)
        stamps = {name: stamp_to_msg(stamp) for name, stamp in times.items()}
        header = header_to_msg(FRAME, self.clock[0])
        self.adapter.add_executed(ExecutedGrasp(header=header, grasp_id=grasp_id, success=True, **stamps))
        return Interval(**times)


def spent_ms(work: Callable[[], object]) -> float:
    """CPU time of one call [ms]."""
    began = time.process_time()
    work()
    return 1e3 * (time.process_time() - began)


def in_turn(baseline: Callable[[], object], work: Callable[[], object], rounds: int) -> tuple[float, float, float]:
    """Both called alternately: medians of each and of the difference [ms], which is robust on a busy machine."""
    pairs = np.array([(spent_ms(baseline), spent_ms(work)) for _ in range(rounds)])
    alone, whole = np.median(pairs, axis=0)
    return float(alone), float(whole), float(np.median(pairs[:, 1] - pairs[:, 0]))


def whole_and_rest(pairs: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """Of (model's part, whole) [ms], the medians of the whole and of the rest."""
    model, whole = np.transpose(pairs)
    return float(np.median(whole)), float(np.median(whole - model))


def can(points: int) -> Cloud:
    """The near half of a lying can, in the camera's frame [m]."""
    rng = np.random.default_rng(1)
    angle, along = rng.uniform(0, np.pi, points), rng.uniform(-0.05, 0.05, points)
    return Cloud(
        np.column_stack([0.033 * np.cos(angle), along, 1.2 - 0.033 * np.sin(angle)]).astype(np.float32), frame_id=FRAME
    )


def measure(model: TouchModel, points: int, rounds: int) -> dict[str, tuple[float, ...]]:
    """By name, medians of the whole and, where the model is called, of what adaptation adds to it [ms]."""
    clock, settings = [time.time_ns()], TouchPredictorConfig()
    history, alone_history = HandHistory(model), HandHistory(model)
    adapter = OnlineAdapter(model, make_reader(TactileConfig()), history, lambda: settings, lambda: clock[0], print)
    hand = Hand(adapter, clock)
    grasps = [Grasp(np.array(G1), np.array(G2), np.eye(3), 1.0, f"g{k}", "1") for k in range(TOUCHES)]
    message = objects_to_msg([FoundObject("1", can(points), ASSUMED_TABLE)], FRAME, clock[0])
    (target,) = objects_from_msg(message, ASSUMED_TABLE)
    cloud, asked = target.cloud, grasps[:1]

    def ask() -> Sequence[TouchPrediction]:
        return adapter.predict(cloud, asked, limits=settings.limits, reach=settings)

    def ask_model() -> Sequence[TouchPrediction]:
        return model.predict(cloud, asked)

    def basis() -> dict[str, Any]:
        tare = adapter._recent_tare(settings)  # noqa: SLF001  what the adapter itself reads
        if tare is not None:
            alone_history.add_tare(clock[0], tare)
        same = alone_history.is_current(cloud, settings.same_object_m)
        return {"history": alone_history.snapshot(clock[0], same_object=same, tare=tare is not None)}

    def add(grasp: Grasp, cut: Any) -> None:
        alone_history.add_tare(clock[0], cut.tare)
        new = not alone_history.is_current(cloud, settings.same_object_m)
        alone_history.add_touch(clock[0], cloud, grasp, cut.touch, new_object=new)

    hand.send(REST, 300)
    alone, *with_tare = in_turn(ask_model, ask, rounds)
    basis()  # reads the same tare
    buffered, matched, added = [], [], []
    for grasp in grasps:
        objects, planned = objects_to_msg([target], FRAME, clock[0]), [grasp_to_msg(grasp)]
        buffered.append(spent_ms(partial(adapter.add_grasps, objects, planned)))
        interval = hand.execute(grasp.id)
        cut = cut_touch(hand.buffer, interval, settings.pairing)
        estimate = partial(model.estimate_executed, cloud, [grasp])
        matched.append((spent_ms(estimate), spent_ms(adapter.process_touches)))
        added.append((spent_ms(estimate), spent_ms(partial(add, grasp, cut))))
    require_equal(model.predict(cloud, asked, **basis()), ask(), adapter)
    _, *with_touches = in_turn(ask_model, ask, rounds)
    return {
        "model alone": (alone,),
        "with a tare": tuple(with_tare),
        "with touches": tuple(with_touches),
        "add a touch": whole_and_rest(added),
        "match and add it": whole_and_rest(matched),
        "buffer a cloud": (float(np.median(buffered)),),
        "a tactile message": (1e3 * float(np.median(hand.times)),),
    }


def require_equal(model: Sequence[TouchPrediction], node: Sequence[TouchPrediction], adapter: OnlineAdapter) -> None:
    """End the program unless the predictor's prediction equals the model's with the same touches."""
    if model[0].value is None or node[0].value is None or adapter.touches() != TOUCHES:
        raise SystemExit(f"refused, or {adapter.touches()} of {TOUCHES} touches used: {adapter.notes()}")
    if not np.array_equal(model[0].value.vector(), node[0].value.vector()):
        raise SystemExit(f"the prediction is not the model's: {adapter.notes()}")


def main() -> None:
    """Prove equal predictions, then time."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--model", default="default")
    parser.add_argument("--rounds", type=int, default=200)
    parser.add_argument("--points", type=int, default=3000)
    arguments = parser.parse_args()
    model = load_model(arguments.model)
    figures = measure(model, arguments.points, arguments.rounds)

    print(f"{model.name}, {arguments.points} points, one grasp; predictions equal the model's. CPU time, median [ms]:")
    print(f"  {'':20} {'whole':>10} {'adaptation':>10}")
    for name, costs in figures.items():
        print(f"  {name:20} {''.join(f'{cost:11.3f}' for cost in costs)}")
    command = [sys.executable, "-c", LOAD.format(arguments.model)]
    loads = [float(subprocess.run(command, capture_output=True, check=True).stdout) for _ in range(5)]
    print(f"load in a fresh process: {np.median(loads):.3f} s (wall, median of 5)")


if __name__ == "__main__":
    main()
