# SPDX-License-Identifier: Apache-2.0
"""The processes that share a batch out, and sums over them for losses that are no mean of the processes' own.

Data-parallel training averages the gradients of all ranks. That is right for a loss that is a mean over samples
and wrong for a root of a mean or a distance of means: there the sum must be taken over all ranks first.

Every rank draws the same batch, points and noise from the same seed and takes its own rows of them, so that many
processes do what one does. Dropout is the exception: each rank draws masks for its own rows.

Where a network is trained: on which device, how exactly, and beside which other processes.

The same seed gives the same bits on the same device with the same number of threads and processes. A GPU adds
in no fixed order, so its runs agree with each other and with a CPU's to rounding alone.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, TypeVar

import torch
from torch import Tensor, nn

from foretouch.config import Settings, setting
from foretouch.errors import ConfigError
from foretouch.models.network.pointnet import InputTransform, Layer, PointNetFeatures

__all__ = ["ONE_RANK", "DistributedContext", "Place", "PlaceConfig", "process_group"]


_Rows = TypeVar("_Rows", Tensor, Any)


@dataclass(frozen=True)
class DistributedContext:
    """The processes that share a batch out.

    Attributes:
        size: Their number. With 1 nothing is communicated; with more, `torch.distributed` must be initialised.
        own: Place of this process among them; 0 alone writes files.
    """

    size: int = 1
    own: int = 0

    @classmethod
    def of_process_group(cls) -> DistributedContext:
        """Those of the default process group; one where there is none."""
        group = torch.distributed
        if not (group.is_available() and group.is_initialized()):
            return cls()
        return cls(group.get_world_size(), group.get_rank())

    def sum(self, value: Tensor) -> Tensor:
        """The sum over all ranks, without a gradient; `value` is left as it is."""
        total = value.detach().clone()
        if self.size > 1:
            torch.distributed.all_reduce(total)
        return total

    def shared_sum(self, value: Tensor) -> Tensor:
        """The sum over all ranks, whose gradient is right once the gradients of all ranks are averaged.

        Each rank differentiates its own summand alone, and the average divides by the number of ranks: hence
        the factor.
        """
        if self.size == 1:
            return value
        own = value * self.size
        return own + (self.sum(value) - own).detach()

    def share(self, rows: _Rows) -> _Rows:
        """This rank's rows of a batch, whose number is a multiple of the ranks'."""
        if self.size == 1:
            return rows
        count = len(rows) // self.size
        return rows[self.own * count : (self.own + 1) * count]

    def average_gradients(self, parameters: Iterable[nn.Parameter]) -> None:
        """Replace each gradient by its mean over all ranks, in one exchange."""
        gradients = [parameter.grad for parameter in parameters if parameter.grad is not None]
        if self.size == 1 or not gradients:
            return
        packed = torch.cat([gradient.flatten() for gradient in gradients])
        torch.distributed.all_reduce(packed)
        packed /= self.size
        for gradient, mean in zip(gradients, torch.split(packed, [g.numel() for g in gradients]), strict=True):
            gradient.copy_(mean.view_as(gradient))


ONE_RANK = DistributedContext()
"""No other process takes part."""


@contextmanager
def process_group(device: str) -> Iterator[DistributedContext]:
    """Join the processes that `torchrun` started, for the time of the context; one rank without it.

    Args:
        device: `cuda`, whose sums NCCL takes, or another, where gloo does.
    """
    if int(os.environ.get("WORLD_SIZE", "1")) == 1:
        yield ONE_RANK
        return
    torch.distributed.init_process_group("nccl" if device == "cuda" else "gloo")
    try:
        yield DistributedContext.of_process_group()
        torch.distributed.barrier()  # none leaves while another still works: its end would look like a loss
    finally:
        torch.distributed.destroy_process_group()


@dataclass(frozen=True, kw_only=True)
class PlaceConfig(Settings):
    """What both kinds of training are told of the machine."""

    device: str = setting(
        "auto", "Where to train; auto takes a GPU where there is one", choices=("auto", "cpu", "cuda")
    )
    precision: str = setting(
        "float32",
        "Of the search for the points that win the maximum. With bfloat16 a near equal may win; weights, values and "
        "gradients stay float32",
        choices=("float32", "bfloat16"),
    )

    @property
    def resolved_device(self) -> str:
        """`cpu` or `cuda`.

        Raises:
            ConfigError: If a GPU is asked for and there is none.
        """
        found = torch.cuda.is_available()
        if self.device == "cuda" and not found:
            raise ConfigError(f"{type(self).__name__}.device: cuda: torch finds no GPU; choose auto or cpu")
        return "cuda" if found and self.device != "cpu" else "cpu"


@dataclass(frozen=True)
class Place:
    """A device, a precision and the processes that share each batch out.

    Attributes:
        device: Of weights and batches.
        precision: Of the search for winning points.
        ranks: The processes.
    """

    device: torch.device
    precision: torch.dtype
    ranks: DistributedContext

    @classmethod
    def of(cls, config: PlaceConfig, batch_size: int) -> Place:
        """As configured, with the processes of the default group.

        Args:
            config: Of the training.
            batch_size: Samples of a step.

        Raises:
            ConfigError: If there is no such device, or the processes cannot share a batch evenly.
        """
        ranks = DistributedContext.of_process_group()
        if batch_size % ranks.size:
            raise ConfigError(
                f"{type(config).__name__}.batch_size: {batch_size} is no multiple of the {ranks.size} processes"
            )
        device = torch.device(config.resolved_device)
        if device.type == "cuda":
            device = torch.device("cuda", int(os.environ.get("LOCAL_RANK", "0")))
        return cls(device, torch.bfloat16 if config.precision == "bfloat16" else torch.float32, ranks)

    @property
    def first(self) -> bool:
        """Whether this process is the one that writes."""
        return self.ranks.own == 0

    def settle(self, module: nn.Module) -> None:
        """Move a network here and tell its layers; its weights stay the same."""
        module.to(self.device)
        for part in module.modules():
            if isinstance(part, PointNetFeatures | InputTransform):
                part.precision = self.precision
            elif isinstance(part, Layer):
                part.total = self.ranks.sum if self.ranks.size > 1 else None

    def share(self, rows: Tensor) -> Tensor:
        """This process's rows of a batch, on the device."""
        own: Tensor = self.ranks.share(rows)
        return own.to(self.device)
