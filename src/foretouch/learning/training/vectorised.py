# SPDX-License-Identifier: Apache-2.0
"""Many supervised trainings of one shape at once, with different seeds, samples or modalities, as one stack of weights.

Each run keeps its own weights, order, points and scaling; a step is one batched product for all of them. The result
of a run equals that of `train_network` up to rounding. On a CPU this is faster only for the smallest networks
(see benchmarks/training); it is meant for GPUs, which small runs one after the other leave mostly idle.

Shapes: R runs, B samples, N points, C channels, G grasp numbers, M outputs.
"""

import copy
from collections.abc import Sequence

import torch
from torch import Tensor, nn
from torch.func import functional_call, stack_module_state

from foretouch.errors import ConfigError, DatasetError
from foretouch.learning.data import Indices, TrainingSet
from foretouch.learning.training.losses import labeled_loss
from foretouch.learning.training.supervised import SupervisedTrainer, TrainConfig
from foretouch.learning.training.trainer import OptimiserRule, ScheduledOptimiser
from foretouch.models.network.networks import TouchNet
from foretouch.models.network.pointnet import Layer


def train_many(
    data: Sequence[TrainingSet], indices: Sequence[Indices], configs: Sequence[TrainConfig]
) -> list[TouchNet]:
    """Train one network per run.

    Args:
        data: (R,) samples; their networks differ at most in which modalities of the same size they predict.
        indices: (R,) training samples, of equally many whole batches.
        configs: (R,) settings, equal except for the seed.

    Returns:
        (R,) networks on the CPU, in evaluation mode.

    Raises:
        ConfigError: If the runs are not of one shape, or use dropout, whose masks each run would have to draw itself.
        DatasetError: If a run has fewer samples than one batch, or its loss becomes infinite or NaN.
    """
    runs = [SupervisedTrainer(one, index, config) for one, index, config in zip(data, indices, configs, strict=True)]
    if not runs:
        return []
    _require_one_shape(runs)
    stack = _Stack(runs)
    for epoch in range(runs[0].epochs):
        for number, batches in enumerate(zip(*[run.batches() for run in runs], strict=True)):
            points, grasps, targets = (torch.stack([batch[k] for batch in batches]) for k in (1, 2, 3))
            stack.step(points, grasps, targets, f"epoch {epoch}, batch {number}")
    return stack.networks()


class _Stack:
    """The weights of all runs, each (R, ...), and one optimiser for them; the runs must be of one shape."""

    def __init__(self, runs: Sequence[SupervisedTrainer]) -> None:
        self._nets = [run.net.train() for run in runs]
        weights, self._buffers = stack_module_state(self._nets)
        self._weights: dict[str, Tensor] = {name: nn.Parameter(value.detach()) for name, value in weights.items()}
        self._shape = copy.deepcopy(self._nets[0])
        for layer in self._shape.modules():
            if isinstance(layer, Layer):
                layer.moments = False
        first = runs[0]
        config = first.config
        self._kind, self._epsilon, self._sizes = config.loss, config.root_epsilon, first.sizes
        self._grasp = first.data.config.use_grasp
        rule = OptimiserRule(config.optimiser, config.learning_rate, config.weight_decay, config.schedule)
        steps = config.epochs * first.batch_count
        # The optimisers work value by value, so a step of the stack is a step of each of its networks.
        self._optimiser = ScheduledOptimiser(nn.ParameterList([*self._weights.values()]), rule, steps)
        self._losses = torch.vmap(self._loss)

    def step(self, points: Tensor, grasps: Tensor, targets: Tensor, where: str) -> None:
        """One step of every run: (R, B, N, C), (R, B, G) and (R, B, M)."""
        losses = self._losses(self._weights, self._buffers, points, grasps, targets)
        finite = torch.isfinite(losses.detach())
        if not bool(finite.all()):
            raise DatasetError(
                f"training: run {int((~finite).int().argmax())}: the loss is not finite in {where}; lower learning_rate"
            )
        self._optimiser.step(losses.sum())  # each weight is in only one summand

    def networks(self) -> list[TouchNet]:
        """The networks of the runs with their current weights."""
        for k, net in enumerate(self._nets):
            values = {name: value[k].detach() for name, value in [*self._weights.items(), *self._buffers.items()]}
            net.load_state_dict(values)
        return [net.cpu().eval() for net in self._nets]

    def _loss(
        self, weights: dict[str, Tensor], buffers: dict[str, Tensor], points: Tensor, grasp: Tensor, target: Tensor
    ) -> Tensor:
        inputs = (points, grasp) if self._grasp else (points,)
        scaled: Tensor = functional_call(self._shape, (weights, buffers), inputs)
        return labeled_loss(scaled, target, self._sizes, self._kind, epsilon=self._epsilon)


def _require_one_shape(runs: Sequence[SupervisedTrainer]) -> None:
    first = runs[0]
    for number, run in enumerate(runs):
        model = run.data.config.replace(outputs=first.data.config.outputs)
        if run.config.replace(seed=0) != first.config.replace(seed=0):
            raise ConfigError(f"train_many: run {number}: its TrainConfig differs from run 0 in more than the seed")
        if model != first.data.config or run.sizes != first.sizes or run.batch_count != first.batch_count:
            raise ConfigError(f"train_many: run {number}: is of another shape than run 0")
    if first.data.config.head_dropout > 0.0:
        raise ConfigError("train_many: ModelConfig.head_dropout: must be 0, since each run would draw its own masks")
    if first.training_device.context.world_size > 1:
        raise ConfigError("train_many: requires a single process")
