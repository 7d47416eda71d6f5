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

The network as torch's modules, which a robot does not need, is `foretouch_lab.learning.network`.

Shapes: N points, C channels, F features, K grasps, G grasp numbers, M outputs.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import torch
from torch import Tensor, nn

from foretouch.models.network.config import ModelConfig

BLOCK = 16
"""Rows of one pass through the head."""

_NORM = ("weight", "bias", "running_mean", "running_var")
_EPSILON = 1e-5  # that torch's batch norm adds to the variance


def tensor_shapes(config: ModelConfig) -> dict[str, tuple[int, ...]]:
    """Shapes of all tensors of a network by name; all are float32 but `num_batches_tracked`, which are int64."""
    found: dict[str, tuple[int, ...]] = dict.fromkeys(("target_mean", "target_scale"), (config.output_size,))

    def add(prefix: str, widths: Sequence[int], *, norm: bool = True) -> None:
        for k, (inputs, outputs) in enumerate(pairwise(widths)):
            found[f"{prefix}.{k}.linear.weight"], found[f"{prefix}.{k}.linear.bias"] = (outputs, inputs), (outputs,)
            if norm:
                found.update({f"{prefix}.{k}.norm.{name}": (outputs,) for name in _NORM})
                found[f"{prefix}.{k}.norm.num_batches_tracked"] = ()

    last = [config.head_size, *config.head_widths][-1]
    found["output.weight"], found["output.bias"] = (config.output_size, last), (config.output_size,)
    add("features.layers", [config.channel_count, *config.trunk_widths])
    add("head", [config.head_size, *config.head_widths], norm=config.head_norm)
    if config.tnet:
        add("features.transform.points", [config.channel_count, *config.tnet_widths[:3]])
        add("features.transform.cloud", config.tnet_widths[2:])
        matrix = "features.transform.matrix"
        found[f"{matrix}.weight"], found[f"{matrix}.bias"] = (9, config.tnet_widths[-1]), (9,)
    return found


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


def fold(config: ModelConfig, tensors: Mapping[str, Tensor], precision: str | None = None) -> FoldedNetwork:
    """Fold a trained network; later training of the network does not change the copy.

    Args:
        config: Its architecture.
        tensors: By the names of `tensor_shapes`. Batch norm is folded with its running statistics, as in evaluation.
        precision: As `ModelConfig.precision`, which is the default.
    """
    dtype = getattr(torch, config.precision if precision is None else precision)
    tensors = {name: value.detach().double() for name, value in tensors.items()}
    transform = None
    if config.tnet:
        points = _folded(tensors, "features.transform.points")
        matrix = _Affine(*(tensors[f"features.transform.matrix.{name}"].float() for name in ("weight", "bias")))
        transform = _shared(points, dtype), (*_folded(tensors, "features.transform.cloud"), matrix)
    scale, mean = tensors["target_scale"], tensors["target_mean"]
    output = (tensors["output.weight"] * scale[:, None]).float().contiguous()
    bias = (tensors["output.bias"] * scale + mean).float()
    first, *rest = *_folded(tensors, "head"), _Affine(output, bias)
    return FoldedNetwork(
        transform=transform,
        trunk=_shared(_folded(tensors, "features.layers"), dtype),
        trunk_relu=config.trunk_relu,
        first=_Affine(first.weight[:, : config.feature_size].contiguous(), first.bias),
        first_grasp=first.weight[:, config.feature_size :].contiguous(),
        head=tuple(rest),
    )


def _folded(tensors: Mapping[str, Tensor], prefix: str) -> list[_Affine]:
    """Consecutive layers, in float32, with their batch norms merged in double precision."""
    found: list[_Affine] = []
    while (name := f"{prefix}.{len(found)}.linear.weight") in tensors:
        weight, bias = tensors[name], tensors[f"{prefix}.{len(found)}.linear.bias"]
        norm = f"{prefix}.{len(found)}.norm."
        if f"{norm}weight" in tensors:
            gain, shift, mean, variance = (tensors[norm + part] for part in _NORM)
            scale = gain / torch.sqrt(variance + _EPSILON)
            weight, bias = weight * scale[:, None], (bias - mean) * scale + shift
        found.append(_Affine(weight.float().contiguous(), bias.float()))
    return found


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
