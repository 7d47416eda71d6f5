# SPDX-License-Identifier: Apache-2.0
"""Sums over the processes that share a batch out, for losses that are no mean of the processes' own.

Data-parallel training averages the gradients of all ranks. That is right for a loss that is a mean over samples
and wrong for a root of a mean or a distance of means: there the sum must be taken over all ranks first.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

__all__ = ["ONE_RANK", "Ranks"]


@dataclass(frozen=True)
class Ranks:
    """The processes that share a batch out.

    Attributes:
        size: Their number. With 1 nothing is communicated; with more, `torch.distributed` must be initialised.
    """

    size: int = 1

    @classmethod
    def of_process_group(cls) -> Ranks:
        """Those of the default process group; one where there is none."""
        group = torch.distributed
        return cls(group.get_world_size() if group.is_available() and group.is_initialized() else 1)

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


ONE_RANK = Ranks()
"""No other process takes part."""
