# SPDX-License-Identifier: Apache-2.0
"""A trained network as plain matrices: batch norm folded in, features computed once for each cloud.

Three rewrites, none of which changes the function:

- Batch norm in evaluation is y = a x + b per channel, so it merges into the linear map before it.
- The last shared layer takes the maximum over the points before it adds the bias and applies ReLU:
  both are monotonic, so the result is the same without 750 x 1024 additions.
- The first layer of the head splits into the columns for the features, applied once for each cloud, and
  those for the grasp, applied once for each grasp.

With `ModelConfig.precision` bfloat16 the shared layers after the first, which take most of the time, are computed in
bfloat16, with sums in float32: a processor with bfloat16 instructions (AVX-512 BF16, AMX) is three times as fast.

The head runs in blocks of `BLOCK` rows, the last one padded: all matrix products have the same size, so a
prediction is equal to the last bit however many grasps are predicted in the same call.

Shapes: N points, C channels, F features, K grasps, G grasp numbers, M outputs.
"""

import copy
from collections.abc import Iterable
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from foretouch.models.network.networks import TouchNet
from foretouch.models.network.pointnet import InputTransform, Layer

BLOCK = 16
"""Rows of one pass through the head."""


@dataclass(frozen=True, eq=False)
class _Affine:
    """x to x Wᵀ + b."""

    weight: Tensor  # (out, in) float32, or bfloat16 in shared layers
    bias: Tensor  # (out,), of the same dtype

    def __call__(self, x: Tensor) -> Tensor:
        """(..., in) to (..., out)."""
        return nn.functional.linear(x, self.weight, self.bias)


@dataclass(frozen=True, eq=False)
class FoldedNetwork:
    """A network for prediction, of immutable matrices: threads may share it.

    Attributes:
        transform: Shared layers, cloud layers and matrix of the T-Net, or None.
        trunk: Shared layers over the points.
        trunk_relu: Whether the last of them ends in a ReLU.
        first: First map of the head, columns of the features.
        first_grasp: (width, G), its columns of the grasp; G may be 0.
        head: The remaining maps; all but the last are followed by a ReLU.
    """

    transform: tuple[tuple[_Affine, ...], tuple[_Affine, ...]] | None
    trunk: tuple[_Affine, ...]
    trunk_relu: bool
    first: _Affine
    first_grasp: Tensor
    head: tuple[_Affine, ...]

    @torch.inference_mode()
    def features(self, points: Tensor) -> Tensor:
        """(N, C) float32 points of one cloud to its (F,) features."""
        if self.transform is not None:
            shared, rest = self.transform
            matrix = _chain(rest, _pooled(shared, points, relu=True)[None]).view(3, 3)
            points = torch.cat([points[:, :3] @ matrix, points[:, 3:]], dim=1)
        return _pooled(self.trunk, points, relu=self.trunk_relu)

    @torch.inference_mode()
    def regress(self, features: Tensor, grasps: Tensor) -> Tensor:
        """(F,) features and (K, G) grasps to (K, M) predictions [counts]; K may be 0."""
        count = grasps.shape[0]
        padded = torch.zeros((-(-count // BLOCK) * BLOCK, grasps.shape[1]))
        padded[:count] = grasps
        shared = self.first(features)
        blocks = [self._block(shared, block) for block in torch.split(padded, BLOCK)] if count else []
        return torch.cat(blocks)[:count] if blocks else torch.empty((0, self.output_size))

    @property
    def output_size(self) -> int:
        """M."""
        return (self.head[-1] if self.head else self.first).weight.shape[0]

    def _block(self, shared: Tensor, grasps: Tensor) -> Tensor:
        x = nn.functional.linear(grasps, self.first_grasp) + shared
        return _chain(self.head, torch.relu_(x)) if self.head else x


def fold(net: TouchNet, precision: str | None = None) -> FoldedNetwork:
    """Fold a trained network; later training of the network does not change the copy.

    Args:
        net: In any mode; batch norm is folded with its running statistics, as in evaluation.
        precision: As `ModelConfig.precision`, which is the default.
    """
    config = net.config
    dtype = getattr(torch, config.precision if precision is None else precision)
    transform = net.features.transform
    first, *rest = *_fold_layers(net.head), _fold_output(net)
    return FoldedNetwork(
        transform=None if transform is None else _fold_transform(transform, dtype),
        trunk=_shared(_fold_layers(net.features.layers), dtype),
        trunk_relu=config.trunk_relu,
        first=_Affine(first.weight[:, : config.feature_size].contiguous(), first.bias),
        first_grasp=first.weight[:, config.feature_size :].contiguous(),
        head=tuple(rest),
    )


def _pooled(layers: tuple[_Affine, ...], points: Tensor, *, relu: bool) -> Tensor:
    x, last = points, layers[-1]
    for layer in layers[:-1]:
        x = torch.relu_(layer(x.to(layer.weight.dtype)))
    if last.weight.dtype == torch.float32:
        pooled = (x @ last.weight.T).amax(dim=0) + last.bias
        return torch.relu_(pooled) if relu else pooled
    values = last(x.to(last.weight.dtype))
    if not relu:
        return values.amax(dim=0).float()
    # Numbers that are not negative are in the order of their bits, whose maximum is eight times as fast.
    return torch.relu_(values.view(torch.int16).amax(dim=0).view(values.dtype)).float()


def _chain(layers: tuple[_Affine, ...], x: Tensor) -> Tensor:
    for layer in layers[:-1]:
        x = torch.relu_(layer(x))
    return layers[-1](x)


def _shared(layers: list[_Affine], dtype: torch.dtype) -> tuple[_Affine, ...]:
    """Layers over the points, all but the first in a precision: that one has three inputs, which are positions."""
    return (layers[0], *(_Affine(layer.weight.to(dtype), layer.bias.to(dtype)) for layer in layers[1:]))


def _fold_transform(transform: InputTransform, dtype: torch.dtype) -> tuple[tuple[_Affine, ...], tuple[_Affine, ...]]:
    matrix = _Affine(transform.matrix.weight.detach().clone(), transform.matrix.bias.detach().clone())
    return _shared(_fold_layers(transform.points), dtype), (*_fold_layers(transform.cloud), matrix)


@torch.no_grad()
def _fold_layers(layers: Iterable[nn.Module]) -> list[_Affine]:
    found = [copy.deepcopy(layer).double().folded() for layer in layers if isinstance(layer, Layer)]
    return [_Affine(weight.float().contiguous(), bias.float()) for weight, bias in found]


def _fold_output(net: TouchNet) -> _Affine:
    scale, mean = net.target_scale.double(), net.target_mean.double()
    weight, bias = net.output.weight.detach().double(), net.output.bias.detach().double()
    return _Affine((weight * scale[:, None]).float().contiguous(), (bias * scale + mean).float())
