# SPDX-License-Identifier: Apache-2.0
"""Where a network is trained: on which device, how exactly, and beside which other processes.

The same seed gives the same bits on the same device with the same number of threads and processes. A GPU adds
in no fixed order, so its runs agree with each other and with a CPU's to rounding alone.
"""

from __future__ import annotations

import os
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from foretouch.config import Settings, setting
from foretouch.errors import ConfigError
from foretouch.learning.ranks import Ranks
from foretouch.models.pointnet import InputTransform, Layer, PointNetFeatures

__all__ = ["Place", "PlaceConfig"]


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
    ranks: Ranks

    @classmethod
    def of(cls, config: PlaceConfig, batch_size: int) -> Place:
        """As configured, with the processes of the default group.

        Args:
            config: Of the training.
            batch_size: Samples of a step.

        Raises:
            ConfigError: If there is no such device, or the processes cannot share a batch evenly.
        """
        ranks = Ranks.of_process_group()
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
