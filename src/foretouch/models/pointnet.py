# SPDX-License-Identifier: Apache-2.0
"""PointNet features: one vector for a cloud, whatever the order of its points.

    points (B, N, C) ─ T-Net ─► (B, N, C) ─ shared layers 64, 128, 1024 ─► (B, N, F) ─ max over N ─► (B, F)

After Qi et al. 2017, the network that P1 and P2 build on. Points stand in rows and the shared layers are
plain linear maps, which is the same function as the usual 1-D convolutions of kernel 1 and faster on CPUs.
In evaluation each batch norm is an affine map that `foretouch.models.folding` merges into its layer.

Shapes: B clouds, N points, C channels, F features.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn import functional

from foretouch.errors import ModelError
from foretouch.models.settings import ModelConfig

__all__ = ["InputTransform", "Layer", "PointNetFeatures", "make_layers", "pool"]


class Layer(nn.Module):
    """Linear map, batch norm over all leading axes (or none), ReLU.

    Shapes: (..., in_width) to (..., out_width).
    """

    def __init__(self, in_width: int, out_width: int, *, norm: bool = True) -> None:
        super().__init__()
        self.linear = nn.Linear(in_width, out_width)
        self.norm = nn.BatchNorm1d(out_width) if norm else None

    @property
    def affine(self) -> bool:
        """Whether the layer is an affine map and ReLU: no batch norm, or one whose statistics are fixed."""
        return self.norm is None or not self.norm.training

    def folded(self) -> tuple[Tensor, Tensor]:
        """Weight and bias of that map, through which gradients reach all parameters; only where it is `affine`."""
        if self.norm is None:
            return self.linear.weight, self.linear.bias
        mean, variance = self.norm.running_mean, self.norm.running_var
        if mean is None or variance is None:
            raise ModelError("batch norm: keeps no statistics, so it cannot be folded")
        scale = self.norm.weight / torch.sqrt(variance + self.norm.eps)
        return self.linear.weight * scale[:, None], (self.linear.bias - mean) * scale + self.norm.bias

    def forward(self, x: Tensor) -> Tensor:
        """Apply the layer."""
        if self.affine and torch.is_grad_enabled():  # spares two passes over the points, and their gradients
            return torch.relu(functional.linear(x, *self.folded()))
        y: Tensor = self.linear(x)
        if self.norm is not None:
            y = self.norm(y.flatten(0, -2)).view_as(y)
        return torch.relu(y)


def make_layers(widths: Sequence[int], *, norm: bool = True) -> nn.Sequential:
    """Layers between consecutive widths; none for a single width."""
    return nn.Sequential(*[Layer(a, b, norm=norm) for a, b in pairwise(widths)])


def pool(layers: nn.Sequential, points: Tensor) -> Tensor:
    """The largest value of each feature over the points, after some layers.

    Where the last layer is affine and gradients are wanted, the point that wins each feature is found without
    them, and the feature is computed once more from that point alone. Value and gradient are the same, but
    for rounding, and the gradient costs a product for each feature instead of one for each feature and point.

    Shapes: (B, N, C) to (B, F).

    Args:
        layers: At least one.
        points: The clouds.
    """
    last = layers[-1]
    if not (isinstance(last, Layer) and last.affine and torch.is_grad_enabled()):
        features: Tensor = layers(points).amax(dim=1)
        return features
    hidden: Tensor = layers[:-1](points)
    weight, bias = last.folded()
    with torch.no_grad():  # bias and ReLU move no winner
        winner = (weight @ hidden.transpose(1, 2).contiguous()).argmax(dim=-1)
    clouds, size = hidden.shape[:2]
    rows = (winner + size * torch.arange(clouds, device=winner.device)[:, None]).flatten()
    chosen = hidden.flatten(0, 1).index_select(0, rows).view(clouds, -1, hidden.shape[2])
    return torch.relu((chosen * weight).sum(dim=-1) + bias)


class InputTransform(nn.Module):
    """T-Net: a learned 3 x 3 matrix that turns the coordinates of a cloud.

    Only x, y, z are turned; colours and normals pass unchanged. It starts as the identity.

    Shapes: (B, N, C) to (B, N, C), C at least 3.
    """

    def __init__(self, channels: int, widths: Sequence[int]) -> None:
        super().__init__()
        self.points = make_layers([channels, *widths[:3]])
        self.cloud = make_layers(widths[2:])
        self.matrix = nn.Linear(widths[-1], 9)
        nn.init.zeros_(self.matrix.weight)
        with torch.no_grad():
            self.matrix.bias.copy_(torch.eye(3).flatten())

    def forward(self, points: Tensor) -> Tensor:
        """Turn the points."""
        matrix = self.matrix(self.cloud(pool(self.points, points))).view(-1, 3, 3)
        return torch.cat([points[..., :3] @ matrix, points[..., 3:]], dim=-1)


class PointNetFeatures(nn.Module):
    """The feature vector of a cloud: f(x) in P2, compared by the losses of the SR-GAN.

    Shapes: (B, N, C) to (B, F).
    """

    def __init__(self, config: ModelConfig) -> None:
        super().__init__()
        channels = config.channel_count
        self.transform = InputTransform(channels, config.tnet_widths) if config.tnet else None
        self.layers = make_layers([channels, *config.trunk_widths])

    def forward(self, points: Tensor) -> Tensor:
        """Features of each cloud."""
        if self.transform is not None:
            points = self.transform(points)
        return pool(self.layers, points)
