# SPDX-License-Identifier: Apache-2.0
"""Samples a second of supervised training and seconds a step of the SR-GAN, against the plain composition."""

import argparse
import statistics
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import nullcontext
from typing import Any

import numpy as np
import torch

from benchmarks.training.plain import plain_composition
from foretouch.models.network.config import ModelConfig
from foretouch.tactile import TOUCH_SIZE
from foretouch_lab.learning.data.training_set import TrainingSet
from foretouch_lab.learning.training.srgan import SrganConfig, SrganTrainer
from foretouch_lab.learning.training.supervised import SupervisedTrainer, TrainConfig
from foretouch_lab.learning.training.trainer import Trainer

FULL = ModelConfig(channels="xyz+normals", outputs=("PDC_TH",))
"""P2's network: 750 points of six channels, T-Net, 1024 features."""

SLIM = FULL.replace(n_points=128, tnet=False, trunk_widths=(32, 64, 128), head_widths=(128, 64))
"""As small as sweeps use it: here the number of calls counts, not their size."""

CLOUD_POINTS = 5000


def made_data(config: ModelConfig, samples: int) -> TrainingSet:
    """Random clouds: no time depends on what they show."""
    rng = np.random.default_rng(0)
    clouds = tuple(rng.uniform(-0.6, 0.6, (CLOUD_POINTS, 6)).astype(np.float32) for _ in range(samples))
    labels = rng.normal(2800.0, 100.0, (samples, TOUCH_SIZE))
    grasps = rng.normal(size=(samples, config.grasp_size)).astype(np.float32)
    ids = tuple(str(k) for k in range(samples))
    return TrainingSet(clouds, grasps, labels, np.ones((samples, 5)), config, ids)


def supervised(config: ModelConfig, batch: int, precision: str, batches: int) -> Trainer:
    """Batch norm in training, Adam, as P2."""
    data = made_data(config, batch * batches)
    how = TrainConfig(epochs=1000, batch_size=batch, optimiser="adam", device="cpu", precision=precision)
    return SupervisedTrainer(data, np.arange(batch * batches), how)


def srgan(config: ModelConfig, precision: str, batches: int, batch_norm: str = "frozen") -> Trainer:
    """Ten labelled, ten unlabelled and ten fake clouds; the reading that looks at all three."""
    data = made_data(config, 20 * batches)
    points = {"points": 750} if config.n_points == 750 else {"points": 125}
    how = SrganConfig(
        epochs=1000, learning_rate=1e-3, device="cpu", precision=precision, batch_norm=batch_norm, **points
    )
    if config.n_points != 750:
        how = how.replace(generator=how.generator.replace(noise_length=1))
    return SrganTrainer(data, np.arange(10 * batches), np.arange(10 * batches, 20 * batches), how)


def weights_after_a_step(make: Callable[[], Trainer], *, plain: bool) -> Mapping[str, torch.Tensor]:
    with plain_composition() if plain else nullcontext():
        trainer = make()
        trainer.run_epoch()
    return trainer.net.state_dict()


def difference(make: Callable[[], Trainer]) -> float:
    """Largest difference of running variances after one epoch of both ways, relative to their size.

    Weights would differ more: Adam turns rounding of small gradients into steps of full size.
    """
    quick, plain = (weights_after_a_step(make, plain=plain) for plain in (False, True))
    return max(
        float((quick[name].double() - value.double()).norm() / value.double().norm().clamp(min=1e-6))
        for name, value in plain.items()
        if name.endswith("running_var")
    )


def seconds(trainer: Trainer, batches: int, repeats: int, *, plain: bool) -> tuple[float, float]:
    """Median wall and CPU time of a step."""
    wall, cpu = [], []
    with plain_composition() if plain else nullcontext():
        trainer.run_epoch()
        for _ in range(repeats):
            began, used = time.perf_counter(), time.process_time()
            trainer.run_epoch()
            wall.append((time.perf_counter() - began) / batches)
            cpu.append((time.process_time() - used) / batches)
    return statistics.median(wall), statistics.median(cpu)


def cases(batches: int) -> Iterator[tuple[str, int, str, Callable[[], Trainer]]]:
    """Name, samples a step, precision, and how to make the trainer."""
    for precision in ("float32", "bfloat16"):
        yield "supervised 750x6", 32, precision, lambda p=precision: supervised(FULL, 32, p, batches)
        yield "SR-GAN 10+10+10, frozen", 10, precision, lambda p=precision: srgan(FULL, p, batches)
    yield "SR-GAN 10+10+10, per source", 10, "float32", lambda: srgan(FULL, "float32", batches, "per_source")
    yield "supervised 128x6 slim, batch 10", 10, "float32", lambda: supervised(SLIM, 10, "float32", 20 * batches)
    yield "SR-GAN 128x6 slim", 10, "float32", lambda: srgan(SLIM, "float32", 20 * batches)


def rows(threads: int, batches: int, repeats: int) -> Iterator[dict[str, Any]]:
    """One row a case: both ways, one after the other."""
    torch.set_num_threads(threads)
    for name, samples, precision, make in cases(batches):
        count = batches * (20 if "slim" in name else 1)
        plain = seconds(make(), count, repeats, plain=True) if precision == "float32" else (None, None)
        quick = seconds(make(), count, repeats, plain=False)
        yield {
            "case": name, "threads": threads, "precision": precision,
            "plain_wall_s": plain[0], "plain_cpu_s": plain[1], "wall_s": quick[0], "cpu_s": quick[1],
            "samples_per_s": samples / quick[0],
        }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--threads", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--batches", type=int, default=3, help="steps of one measurement")
    parser.add_argument("--repeats", type=int, default=5)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    worst = difference(lambda: supervised(FULL, 8, "float32", 1))
    print(f"running variances after one step agree to {worst:.1e}")
    if worst > 1e-3:
        raise SystemExit("the two ways differ; nothing is timed")
    for threads in arguments.threads:
        for row in rows(threads, arguments.batches, arguments.repeats):
            ratio = "" if row["plain_cpu_s"] is None else f"  {row['plain_cpu_s'] / row['cpu_s']:4.1f} x plain (CPU)"
            print(
                f"{row['case']:32} {threads} threads {row['precision']:9} {row['wall_s'] * 1e3:8.1f} ms wall "
                f"{row['cpu_s'] * 1e3:8.1f} ms CPU {row['samples_per_s']:8.1f} samples/s{ratio}",
                flush=True,
            )


if __name__ == "__main__":
    main()
