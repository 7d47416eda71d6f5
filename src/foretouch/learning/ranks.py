# SPDX-License-Identifier: Apache-2.0
"""The processes that share a batch out, and sums over them for losses that are no mean of the processes' own.

Data-parallel training averages the gradients of all ranks. That is right for a loss that is a mean over samples
and wrong for a root of a mean or a distance of means: there the sum must be taken over all ranks first.

Every rank draws the same batch, points and noise from the same seed and takes its own rows of them, so that many
processes do what one does. Dropout is the exception: each rank draws masks for its own rows.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, TypeVar

import torch
from torch import Tensor, nn

__all__ = ["ONE_RANK", "Ranks", "process_group"]

_Rows = TypeVar("_Rows", Tensor, Any)


@dataclass(frozen=True)
class Ranks:
    """The processes that share a batch out.

    Attributes:
        size: Their number. With 1 nothing is communicated; with more, `torch.distributed` must be initialised.
        own: Place of this process among them; 0 alone writes files.
    """

    size: int = 1
    own: int = 0

    @classmethod
    def of_process_group(cls) -> Ranks:
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


ONE_RANK = Ranks()
"""No other process takes part."""


@contextmanager
def process_group(device: str) -> Iterator[Ranks]:
    """Join the processes that `torchrun` started, for the time of the context; one rank without it.

    Args:
        device: `cuda`, whose sums NCCL takes, or another, where gloo does.
    """
    if int(os.environ.get("WORLD_SIZE", "1")) == 1:
        yield ONE_RANK
        return
    torch.distributed.init_process_group("nccl" if device == "cuda" else "gloo")
    try:
        yield Ranks.of_process_group()
        torch.distributed.barrier()  # none leaves while another still works: its end would look like a loss
    finally:
        torch.distributed.destroy_process_group()
