# SPDX-License-Identifier: Apache-2.0
"""Samples a second of supervised training and seconds a step of the SR-GAN, against the plain composition."""

import argparse
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from benchmarks.common import print_rows, timed
from foretouch.models.network.config import ModelConfig
from foretouch.tactile import TOUCH_SIZE
from foretouch_lab.learning.data.training_set import TrainingSet
from foretouch_lab.learning.network import pointnet
from foretouch_lab.learning.network.pointnet import Layer
from foretouch_lab.learning.training.srgan import SrganConfig, SrganTrainer
from foretouch_lab.learning.training.supervised import SupervisedTrainer, TrainConfig
from foretouch_lab.learning.training.trainer import Trainer

FULL = ModelConfig(channels="xyz+normals", outputs=("PDC_TH",))
"""P2's network: 750 points of six channels, T-Net, 1024 features."""

SLIM = FULL.replace(n_points=128, tnet=False, trunk_widths=(32, 64, 128), head_widths=(128, 64))
"""As small as sweeps use it: here the number of calls counts, not their size."""

CLOUD_POINTS = 5000


def _layer(layer: Layer, x: Tensor) -> Tensor:
    y = layer.linear(x)
    if layer.norm is not None:
        y = layer.norm(y.flatten(0, -2)).view_as(y)
    return torch.relu(y)


def _pool(layers: nn.Sequential, points: Tensor, _precision: torch.dtype) -> Tensor:
    for layer in layers:
        points = _layer(layer, points)
    return points.amax(dim=1)


@contextmanager
def plain_composition() -> Iterator[None]:
    """Within, every PointNet of the package is torch's linear maps, batch norms, ReLUs and a maximum, on the same weights."""
    forward, pool = Layer.forward, pointnet.pool
    Layer.forward, pointnet.pool = _layer, _pool  # type: ignore[method-assign,assignment]
    try:
        yield
    finally:
        Layer.forward, pointnet.pool = forward, pool  # type: ignore[method-assign]


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


def difference(make: Callable[[], Trainer]) -> float:
    """Largest difference of running variances after one epoch of both ways, relative to their size.

    Weights would differ more: Adam turns rounding of small gradients into steps of full size.
    """
    quick, plain = make(), make()
    quick.run_epoch()
    with plain_composition():
        plain.run_epoch()
    found = quick.net.state_dict()
    return max(
        float((found[name].double() - value.double()).norm() / value.double().norm().clamp(min=1e-6))
        for name, value in plain.net.state_dict().items()
        if name.endswith("running_var")
    )


def cases(batches: int) -> Iterator[tuple[str, int, str, Callable[[], Trainer]]]:
    """Name, samples a step, precision, and how to make the trainer."""
    for precision in ("float32", "bfloat16"):
        yield "supervised 750x6", 32, precision, lambda p=precision: supervised(FULL, 32, p, batches)
        yield "SR-GAN 10+10+10, frozen", 10, precision, lambda p=precision: srgan(FULL, p, batches)
    yield "SR-GAN 10+10+10, per source", 10, "float32", lambda: srgan(FULL, "float32", batches, "per_source")
    yield "supervised 128x6 slim, batch 10", 10, "float32", lambda: supervised(SLIM, 10, "float32", 20 * batches)
    yield "SR-GAN 128x6 slim", 10, "float32", lambda: srgan(SLIM, "float32", 20 * batches)


def rows(threads: int, batches: int, repeats: int) -> Iterator[dict[str, Any]]:
    """A row for each case and way: the plain one, which has no other precision, and ours."""
    torch.set_num_threads(threads)
    for name, samples, precision, make in cases(batches):
        count = batches * (20 if "slim" in name else 1)
        for way in ("plain", "ours") if precision == "float32" else ("ours",):
            with plain_composition() if way == "plain" else nullcontext():
                wall_s, cpu_s = (one / count for one in timed(make().run_epoch, repeats))
            yield {
                "case": name, "threads": threads, "precision": precision, "way": way,
                "wall_ms": 1e3 * wall_s, "cpu_ms": 1e3 * cpu_s, "samples_per_s": samples / wall_s,
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
        print_rows(list(rows(threads, arguments.batches, arguments.repeats)))


if __name__ == "__main__":
    main()
