# SPDX-License-Identifier: Apache-2.0
"""The device that a network is trained on, and the distributed processes that share each batch.

Data-parallel training averages the gradients of all processes. That is correct for a loss that is a mean over samples
and wrong for a root of a mean or a distance of means: there the sum must be taken over all processes first.

Every process draws the same batch, points and noise from the same seed and takes its own rows of them, so that many
processes compute what one does. Dropout is the exception: each process draws masks for its own rows.

The same seed gives the same bits on the same device with the same number of threads and processes. A GPU adds
in no fixed order, so its results agree with each other and with a CPU's only up to rounding.
"""

import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Self, TypeVar

import torch
from torch import Tensor, nn

from foretouch.config import Settings, setting
from foretouch.errors import ConfigError
from foretouch.models.network.pointnet import InputTransform, Layer, PointNetFeatures

_Rows = TypeVar("_Rows", Tensor, Any)


@dataclass(frozen=True)
class DistributedContext:
    """The processes that share each batch; of several, `torch.distributed` must be initialised."""

    world_size: int = 1  # their number; with 1 nothing is communicated
    rank: int = 0  # number of this process; 0 alone writes files

    @classmethod
    def of_process_group(cls) -> Self:
        """The processes of the default process group; a single one without a group."""
        group = torch.distributed
        if not (group.is_available() and group.is_initialized()):
            return cls()
        return cls(group.get_world_size(), group.get_rank())

    def sum(self, value: Tensor) -> Tensor:
        """The sum over all processes, without a gradient; `value` is not changed."""
        total = value.detach().clone()
        if self.world_size > 1:
            torch.distributed.all_reduce(total)
        return total

    def any(self, flag: bool, device: str) -> bool:
        """Whether the flag is set in any process; `device` is `cuda` or `cpu`, as in training."""
        return bool(self.sum(torch.tensor(float(flag), device=_local_device(device))) > 0)

    def shared_sum(self, value: Tensor) -> Tensor:
        """The sum over all processes, whose gradient is correct once the gradients of all processes are averaged.

        Each process differentiates only its own summand, and the average divides by the number of processes: hence
        the factor.
        """
        if self.world_size == 1:
            return value
        own = value * self.world_size
        return own + (self.sum(value) - own).detach()

    def shard(self, rows: _Rows) -> _Rows:
        """This process's rows of a batch, whose number is a multiple of the number of processes."""
        count = len(rows) // self.world_size
        return rows[self.rank * count : (self.rank + 1) * count]

    def average_gradients(self, parameters: Iterable[nn.Parameter]) -> None:
        """Replace each gradient by its mean over all processes, in one exchange."""
        gradients = [parameter.grad for parameter in parameters if parameter.grad is not None]
        if self.world_size == 1 or not gradients:
            return
        packed = torch.cat([gradient.flatten() for gradient in gradients])
        torch.distributed.all_reduce(packed)
        packed /= self.world_size
        for gradient, mean in zip(gradients, torch.split(packed, [g.numel() for g in gradients]), strict=True):
            gradient.copy_(mean.view_as(gradient))


SINGLE_PROCESS = DistributedContext()
"""Training in this process alone."""


@contextmanager
def process_group(device: str) -> Iterator[DistributedContext]:
    """Join the processes that `torchrun` started, for the time of the context; a single process without it."""
    if int(os.environ.get("WORLD_SIZE", "1")) == 1:
        yield SINGLE_PROCESS
        return
    torch.distributed.init_process_group("nccl" if device == "cuda" else "gloo")
    try:
        yield DistributedContext.of_process_group()
        torch.distributed.barrier()  # none leaves while another still works: its end would look like a failure
    finally:
        torch.distributed.destroy_process_group()


def _local_device(kind: str) -> torch.device:
    """`cpu`, or this process's GPU."""
    return torch.device("cuda", int(os.environ.get("LOCAL_RANK", "0"))) if kind == "cuda" else torch.device(kind)


@dataclass(frozen=True, kw_only=True)
class DeviceConfig(Settings):
    """Settings of the training device, which all networks share."""

    device: str = setting(
        "auto", "Device to train on; auto uses a GPU if there is one", choices=("auto", "cpu", "cuda")
    )
    precision: str = setting(
        "float32",
        "Precision of the search for the points that win the maximum. With bfloat16 a nearly equal point may win; weights, "
        "values and gradients stay float32",
        choices=("float32", "bfloat16"),
    )

    @property
    def resolved_device(self) -> str:
        """`cpu` or `cuda`; a `ConfigError` if a GPU is configured and there is none."""
        found = torch.cuda.is_available()
        if self.device == "cuda" and not found:
            raise ConfigError("device: cuda: torch finds no GPU; choose auto or cpu")
        return "cuda" if found and self.device != "cpu" else "cpu"


@dataclass(frozen=True)
class TrainingDevice:
    """A device, a precision and the processes that share each batch."""

    device: torch.device  # device of weights and batches
    precision: torch.dtype  # precision of the search for winning points
    context: DistributedContext  # the processes

    @classmethod
    def of(cls, config: DeviceConfig, batch_size: int) -> Self:
        """The configured device, with the processes of the default group.

        Raises:
            ConfigError: If there is no such device, or the processes cannot share a batch evenly.
        """
        context = DistributedContext.of_process_group()
        if batch_size % context.world_size:
            raise ConfigError(f"batch_size: {batch_size} is no multiple of the {context.world_size} processes")
        precision = torch.bfloat16 if config.precision == "bfloat16" else torch.float32
        return cls(_local_device(config.resolved_device), precision, context)

    def prepare(self, module: nn.Module) -> None:
        """Move a network to the device and set the precision and the context of its layers.

        Its weights do not change.
        """
        module.to(self.device)
        for part in module.modules():
            if isinstance(part, PointNetFeatures | InputTransform):
                part.precision = self.precision
            elif isinstance(part, Layer):
                part.total = self.context.sum if self.context.world_size > 1 else None

    def shard(self, rows: Tensor) -> Tensor:
        """This process's rows of a batch, on the device."""
        own: Tensor = self.context.shard(rows)
        return own.to(self.device)
