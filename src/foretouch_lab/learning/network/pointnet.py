# SPDX-License-Identifier: Apache-2.0
"""PointNet features: one vector for a cloud, independent of the order of its points.

    points (B, N, C) ─ T-Net ─► (B, N, C) ─ shared layers 64, 128, 1024 ─► (B, N, F) ─ max over N ─► (B, F)

After Qi et al. 2017, the network that P1 and P2 build on. Points are rows and the shared layers are
plain linear maps, which is the same function as the usual 1-D convolutions of kernel 1 and faster on CPUs.
In evaluation each batch norm is an affine map that `foretouch.models.network.folding` merges into its layer.

The last shared layer takes most of the time, 128 to 1024 values at each of 750 points, and the maximum discards all but
one value of each feature. In training the winning points are therefore searched without a graph, and each feature is
computed once more at its winner, with a graph. Value and gradient equal the plain computation's except for
rounding; the gradient costs F products a cloud instead of F N. Batch norm in training allows that, since its statistics
follow from mean and covariance of the inputs (`batch_affine`).

Shapes: B clouds, N points, C channels of the cloud, K inputs of a layer, F features.
"""

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from itertools import pairwise
from typing import Final, TypeAlias

import torch
from torch import Tensor, nn
from torch.nn import functional

from foretouch.errors import ModelError
from foretouch.models.network.config import ModelConfig

_ENOUGH_VALUES: Final = 2**19
"""Values of a layer, rows x outputs, from which batch norm by `batch_affine` is faster than torch's."""

_ENOUGH_ROWS: Final = 16
"""Rows for each input from which the same holds: the matrices of the moments hold inputs² values each."""


def batch_affine(x: Tensor, linear: nn.Linear, norm: nn.BatchNorm1d) -> tuple[Tensor, Tensor]:
    """Return the weight and bias of a linear map with batch norm in training; updates the running statistics as torch does.

    With z = W x + b over n rows x of mean m and covariance C, batch norm is (Ioffe and Szegedy 2015, algorithm 1)::

        E[z] = W m + b        Var[z] = diag(W C Wᵀ)        s = γ / sqrt(Var[z] + ε)
        y = s (z - E[z]) + β = W' x + b'       with       W' = diag(s) W,    b' = β - s (W m)

    so that the outputs need not be computed. Small matrices are in float64, products of rows in the dtype of `x`.

    Args:
        x: (B, N, K) floating.
        linear: K to F.
        norm: Of F channels, with weight and bias.

    Returns:
        (F, K) and (F,), dtype of `linear`.
    """
    rows, weight = x.flatten(0, 1), linear.weight.double()
    mean = rows.mean(dim=0)
    centred = rows - mean  # otherwise the covariance would be the small difference of large numbers
    covariance = (centred.T @ centred).double() / len(rows)
    through = weight @ mean.double()
    variance = ((weight @ covariance) * weight).sum(dim=1).clamp(min=0.0)
    scale = norm.weight / torch.sqrt(variance + norm.eps)
    _update_statistics(norm, through.detach() + linear.bias, variance.detach(), len(rows))
    bias = norm.bias - scale * through + 0.0 * linear.bias  # which batch norm takes away again: its gradient is zero
    return (weight * scale[:, None]).to(linear.weight.dtype), bias.to(linear.weight.dtype)


@torch.no_grad()
def _update_statistics(norm: nn.BatchNorm1d, mean: Tensor, variance: Tensor, count: int) -> None:
    """Update the running statistics as `torch.nn.BatchNorm1d` does, with the unbiased variance of `count` rows."""
    if norm.running_mean is None or norm.running_var is None or norm.num_batches_tracked is None:
        return
    norm.num_batches_tracked.add_(1)
    share = 1.0 / float(norm.num_batches_tracked) if norm.momentum is None else norm.momentum
    norm.running_mean.lerp_(mean.to(norm.running_mean), share)
    norm.running_var.lerp_((variance * (count / max(count - 1.0, 1.0))).to(norm.running_var), share)


@torch.no_grad()
def winners(x: Tensor, weight: Tensor, precision: torch.dtype = torch.float32) -> Tensor:
    """Return (B, F) int64: the point with the largest x Wᵀ, of (B, N, K) points and (F, K) weights.

    `precision` is the precision of the search, if it is lower than the precision of `x`: a point that wins by less than the rounding may then
    lose to a near equal one.
    """
    if precision.itemsize < x.dtype.itemsize:
        x, weight = x.to(precision), weight.to(precision)
    return torch.stack([(weight @ cloud.T).argmax(dim=1) for cloud in x])  # cloud by cloud, which stays in the cache


class Layer(nn.Module):
    """Linear map, batch norm over all leading axes (or none), ReLU (or none).

    Shapes: (..., in_width) to (..., out_width).
    """

    def __init__(self, in_width: int, out_width: int, *, norm: bool = True, relu: bool = True) -> None:
        super().__init__()
        self.relu = relu
        self.linear = nn.Linear(in_width, out_width)
        self.norm = nn.BatchNorm1d(out_width) if norm else None

    def folded(self) -> tuple[Tensor, Tensor]:
        """Return the weight and bias of the layer with its running statistics, with gradients to all parameters."""
        if self.norm is None:
            return self.linear.weight, self.linear.bias
        mean, variance = self.norm.running_mean, self.norm.running_var
        if mean is None or variance is None:
            raise ModelError("batch norm: keeps no statistics, so it cannot be folded")
        scale = self.norm.weight / torch.sqrt(variance + self.norm.eps)
        return self.linear.weight * scale[:, None], (self.linear.bias - mean) * scale + self.norm.bias

    def map_of(self, x: Tensor) -> tuple[Tensor, Tensor] | None:
        """Return the weight and bias of the layer's affine map for this batch, if computing them is faster than the plain layer.

        With batch norm in training that is `batch_affine`. None where there are few rows, as in the head, or fewer
        outputs than inputs, or for prediction without gradients, for which `folding` exists.
        """
        if self.norm is None or not self.norm.training:
            return self.folded() if self.training or torch.is_grad_enabled() else None
        worth = x.dim() == 3 and _worth_moments(x.shape[0] * x.shape[1], self.linear)
        return batch_affine(x, self.linear, self.norm) if worth else None

    def forward(self, x: Tensor) -> Tensor:
        """Apply the layer."""
        affine = self.map_of(x)
        if affine is not None:  # saves two passes over the points, and their gradients
            y = functional.linear(x, *affine)
        else:
            y = self.linear(x)
            y = y if self.norm is None else self.norm(y.flatten(0, -2)).view_as(y)
        return torch.relu_(y) if self.relu else y


def _worth_moments(rows: int, linear: nn.Linear) -> bool:
    inputs, outputs = linear.in_features, linear.out_features
    return inputs <= outputs and rows * outputs >= _ENOUGH_VALUES and rows >= _ENOUGH_ROWS * inputs


def make_layers(widths: Sequence[int], *, norm: bool = True) -> nn.Sequential:
    """Return layers between consecutive widths; no layer for a single width."""
    return nn.Sequential(*[Layer(a, b, norm=norm) for a, b in pairwise(widths)])


def pool(layers: nn.Sequential, points: Tensor, precision: torch.dtype = torch.float32) -> Tensor:
    """Return the largest value of each feature over the points, after some layers.

    Shapes: (B, N, C) to (B, F).

    Args:
        layers: At least one.
        points: The clouds.
        precision: Of the search for the winners; see `winners`. Values and gradients belong to the selected points.
    """
    last = layers[-1]
    hidden: Tensor = layers[:-1](points)
    affine = last.map_of(hidden) if isinstance(last, Layer) else None
    if affine is None:
        features: Tensor = last(hidden).amax(dim=1)
        return features
    weight, bias = affine
    clouds, size = hidden.shape[:2]
    rows = winners(hidden, weight, precision) + size * torch.arange(clouds, device=hidden.device)[:, None]
    won = hidden.flatten(0, 1).index_select(0, rows.flatten()).view(*rows.shape, -1)
    pooled = (won * weight).sum(dim=-1) + bias
    return torch.relu(pooled) if last.relu else pooled  # ReLU is monotonic, so it may follow the maximum


class InputTransform(nn.Module):
    """T-Net: a learned 3 x 3 matrix that is applied to the coordinates of a cloud.

    Only x, y, z are transformed; colours and normals are unchanged. It is initialised to the identity.

    Shapes: (B, N, C) to (B, N, C), C at least 3.

    Attributes:
        precision: Of the search for the winning points in training.
    """

    precision: torch.dtype = torch.float32

    def __init__(self, channels: int, widths: Sequence[int]) -> None:
        super().__init__()
        self.points = make_layers([channels, *widths[:3]])
        self.cloud = make_layers(widths[2:])
        self.matrix = nn.Linear(widths[-1], 9)
        nn.init.zeros_(self.matrix.weight)
        with torch.no_grad():
            self.matrix.bias.copy_(torch.eye(3).flatten())

    def forward(self, points: Tensor) -> Tensor:
        """Transform the points."""
        matrix = self.matrix(self.cloud(pool(self.points, points, self.precision))).view(-1, 3, 3)
        return torch.cat([points[..., :3] @ matrix, points[..., 3:]], dim=-1)


class PointNetFeatures(nn.Module):
    """The feature vector of a cloud: f(x) in P2, compared by the losses of the SR-GAN.

    Shapes: (B, N, C) to (B, F).

    Attributes:
        precision: Of the search for the winning points in training.
    """

    precision: torch.dtype = torch.float32

    def __init__(self, config: ModelConfig) -> None:
        super().__init__()
        channels = config.channel_count
        self.transform = InputTransform(channels, config.tnet_widths) if config.tnet else None
        *inner, width = [channels, *config.trunk_widths]
        self.layers = make_layers(inner).append(Layer(inner[-1], width, relu=config.trunk_relu))

    def forward(self, points: Tensor) -> Tensor:
        """Return features of each cloud."""
        if self.transform is not None:
            points = self.transform(points)
        return pool(self.layers, points, self.precision)


# Control of the running statistics, for training.

Inputs: TypeAlias = tuple[Tensor, Tensor | None]
"""Points (B, N, C) and grasps (B, G) of one batch."""


def freeze(net: nn.Module) -> None:
    """Set all to training mode but batch norm, which keeps its statistics: samples of a batch stay independent."""
    net.train()
    for norm in _norms(net):
        norm.eval()


@torch.no_grad()
def calibrate(net: nn.Module, batches: Iterable[Inputs]) -> None:
    """Set the statistics to their plain mean over some batches of clouds and grasps.

    Args:
        net: Its weights are unchanged; it is in training mode afterwards.
        batches: Points (B, N, C) and grasps (B, G) or None, with B of at least 2.
    """
    momenta = {norm: norm.momentum for norm in _norms(net)}
    for norm in momenta:
        norm.reset_running_stats()
        norm.momentum = None  # makes the running statistics a plain mean
    net.train()
    for points, grasps in batches:
        net(points, grasps)
    for norm, momentum in momenta.items():
        norm.momentum = momentum


@contextmanager
def statistics_kept(net: nn.Module) -> Iterator[None]:
    """Let batch norm in training mode normalise by the batch within the block, but keep its running statistics."""
    momenta = {norm: norm.momentum for norm in _norms(net)}
    for norm in momenta:
        norm.momentum = 0.0
    try:
        yield
    finally:
        for norm, momentum in momenta.items():
            norm.momentum = momentum


def _norms(net: nn.Module) -> list[nn.BatchNorm1d]:
    return [module for module in net.modules() if isinstance(module, nn.BatchNorm1d)]
