# SPDX-License-Identifier: Apache-2.0
"""The device that a network is trained on.

The same seed gives the same bits on the same device with the same number of threads. A GPU adds in no fixed order, so
its results agree with each other and with a CPU's only up to rounding.
"""

from dataclasses import dataclass
from typing import Self

import torch
from torch import nn

from foretouch.config import Settings, setting
from foretouch.errors import ConfigError
from foretouch_lab.learning.network.pointnet import InputTransform, PointNetFeatures


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
    """A device and a precision."""

    device: torch.device  # device of weights and batches
    precision: torch.dtype  # precision of the search for winning points

    @classmethod
    def of(cls, config: DeviceConfig) -> Self:
        """The configured device; a `ConfigError` if this machine has none."""
        precision = torch.bfloat16 if config.precision == "bfloat16" else torch.float32
        return cls(torch.device(config.resolved_device), precision)

    def prepare(self, module: nn.Module) -> None:
        """Move a network to the device and set the precision of its searches; its weights do not change."""
        module.to(self.device)
        for part in module.modules():
            if isinstance(part, PointNetFeatures | InputTransform):
                part.precision = self.precision
