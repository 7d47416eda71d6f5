# SPDX-License-Identifier: Apache-2.0
"""Supervised training of a touch network from a configuration.

P2's own recipe (Adam, constant rate 0.01, RMSE on labels scaled by their ranges) is expressible, but fails to
optimise on the public recordings. The defaults depart from it: AdamW at 1e-3 with a cosine schedule, mean
squared error, labels standardised per value.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from foretouch.config import Settings, setting
from foretouch.errors import DatasetError
from foretouch.learning.augment import turn, viewing_axis_rotations
from foretouch.learning.training_set import TrainingSet
from foretouch.models.regressor import TouchNet
from foretouch.models.settings import ModelConfig
from foretouch.tactile.modalities import columns, modality_size
from foretouch.types import Float64

__all__ = ["TrainConfig", "predict_set", "set_target_scaling", "train_network", "training_loss"]

Indices = npt.NDArray[np.intp]
Report = Callable[[int, float], None]

_LEAST_DEVIATION = 1.0  # [counts], so that an output that never moves does not divide by zero


@dataclass(frozen=True, kw_only=True)
class TrainConfig(Settings):
    """How a network is trained."""

    epochs: int = setting(100, "Passes over the training samples", minimum=1, maximum=100_000)
    batch_size: int = setting(32, "Samples of one step", minimum=2, maximum=4096)
    optimiser: str = setting("adamw", "Rule of the steps", choices=("adamw", "adam", "sgd"))
    learning_rate: float = setting(1e-3, "Largest step", minimum=1e-7, maximum=10.0)
    weight_decay: float = setting(1e-2, "Pull of the weights to zero", minimum=0.0, maximum=10.0)
    schedule: str = setting("cosine", "Course of the learning rate", choices=("cosine", "constant"))
    loss: str = setting("mse", "Mean squared error, or its root as in the papers", choices=("mse", "rmse"))
    target_scaling: str = setting(
        "standardised",
        "Labels by their mean and deviation, or by the ranges as in the papers",
        choices=("standardised", "ranges"),
    )
    points: int | None = setting(
        None, "Points a cloud in training, chosen anew each time; as many as in prediction by default", minimum=8
    )
    turn_deg: float = setting(
        0.0,
        "Turn cloud and grasp about the viewing axis by up to this much; for cameras that look down",
        minimum=0.0,
        maximum=180.0,
        unit="deg",
    )
    seed: int = setting(0, "Of weights, order and points", minimum=0)


def train_network(data: TrainingSet, index: Indices, config: TrainConfig, report: Report | None = None) -> TouchNet:
    """Train a network on some samples.

    Args:
        data: All samples; it knows the network's configuration.
        index: (T,) those to train on.
        config: How.
        report: Called after each epoch with its number and mean loss.

    Returns:
        The network in evaluation mode. The same arguments give the same weights on the same machine.

    Raises:
        DatasetError: If there are fewer samples than one batch, or the loss stops being finite.
    """
    if len(index) < config.batch_size:
        raise DatasetError(f"training: {len(index)} samples are fewer than one batch of {config.batch_size}")
    place = columns(data.config.outputs)
    with torch.random.fork_rng(devices=[]):  # weights and dropout draw from torch's global generator
        torch.manual_seed(config.seed)
        net = TouchNet(data.config)
        set_target_scaling(net, data.labels[np.ix_(index, place)], config)
        _fit(net, data, index, config, report)
    return net.eval()


def _fit(net: TouchNet, data: TrainingSet, index: Indices, config: TrainConfig, report: Report | None) -> None:
    rng = np.random.default_rng(config.seed)
    labels = torch.from_numpy(data.labels[:, columns(data.config.outputs)].astype(np.float32))
    fed = torch.from_numpy(data.grasps)
    optimiser, schedule = _make_optimiser(net, config, config.epochs * (len(index) // config.batch_size))
    net.train()
    for epoch in range(config.epochs):
        losses = []
        for batch in _batches(index, config.batch_size, rng):
            points, grasps = torch.from_numpy(data.points(batch, rng, config.points)), fed[batch]
            if config.turn_deg > 0.0:
                rotations = viewing_axis_rotations(len(batch), config.turn_deg, rng).astype(np.float32)
                points, grasps = turn(points, grasps, torch.from_numpy(rotations), data.config)
            scaled = net(points, grasps if data.config.use_grasp else None)
            loss = training_loss(scaled, net.to_scaled(labels[batch]), data.config, config.loss)
            optimiser.zero_grad(set_to_none=True)
            loss.backward()  # type: ignore[no-untyped-call]
            optimiser.step()
            schedule.step()
            losses.append(float(loss.detach()))
        if not np.isfinite(losses).all():
            raise DatasetError(f"training: the loss is not finite in epoch {epoch}; lower learning_rate")
        if report is not None:
            report(epoch, float(np.mean(losses)))


def set_target_scaling(net: TouchNet, labels: Float64, config: TrainConfig) -> None:
    """Fix the affine map of the targets from (T, M) training labels [counts]."""
    place = columns(net.config.outputs)
    if config.target_scaling == "ranges":
        low, high = net.config.ranges.low[place], net.config.ranges.high[place]
        mean, scale = low, high - low
    else:
        mean, scale = labels.mean(axis=0), np.maximum(labels.std(axis=0), _LEAST_DEVIATION)
    net.set_scaling(torch.from_numpy(mean).float(), torch.from_numpy(scale).float())


def training_loss(scaled: Tensor, target: Tensor, config: ModelConfig, kind: str) -> Tensor:
    """Mean over the modalities of their mean squared error, or of its root (P1; P2, eq. 2).

    Each modality counts alike, so that 24 electrodes do not drown one pressure.

    Args:
        scaled: (B, M) predictions.
        target: (B, M) labels on the same scale.
        config: Tells the modalities of the outputs.
        kind: `mse` or `rmse`.
    """
    sizes = [modality_size(name) for name in config.outputs]
    errors = [part.square().mean() for part in torch.split(scaled - target, sizes, dim=1)]
    stacked = torch.stack(errors)
    # The root has an infinite slope at zero; the shift, far below any real error, bounds it.
    return stacked.mean() if kind == "mse" else torch.sqrt(stacked + 1e-12).mean()


@torch.inference_mode()
def predict_set(net: TouchNet, data: TrainingSet, index: Indices) -> Float64:
    """(T, M) predictions [counts] of some samples, each on the points that prediction would choose."""
    grasps = torch.from_numpy(data.grasps) if data.config.use_grasp else None
    rows = []
    for i in index:
        one = np.array([i])
        points = torch.from_numpy(data.points(one, np.random.default_rng(data.config.sampler_seed)))
        rows.append(net.counts(points, None if grasps is None else grasps[one]))
    return torch.cat(rows).numpy().astype(np.float64)


def _batches(index: Indices, size: int, rng: np.random.Generator) -> Iterator[Indices]:
    """Whole batches of shuffled samples; the rest of an epoch waits for a later shuffle."""
    shuffled = rng.permutation(index)
    for start in range(0, len(shuffled) - size + 1, size):
        yield shuffled[start : start + size]


def _make_optimiser(
    net: TouchNet, config: TrainConfig, steps: int
) -> tuple[torch.optim.Optimizer, torch.optim.lr_scheduler.LRScheduler]:
    kinds: dict[str, type[torch.optim.Optimizer]] = {
        "adamw": torch.optim.AdamW,
        "adam": torch.optim.Adam,
        "sgd": torch.optim.SGD,
    }
    options = {"lr": config.learning_rate, "weight_decay": config.weight_decay}
    optimiser = kinds[config.optimiser](net.parameters(), **options)  # type: ignore[arg-type]
    if config.schedule == "cosine":
        return optimiser, torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, T_max=steps)
    return optimiser, torch.optim.lr_scheduler.ConstantLR(optimiser, factor=1.0)
