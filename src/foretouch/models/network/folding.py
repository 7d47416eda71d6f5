# SPDX-License-Identifier: Apache-2.0
"""A trained network as plain matrices: batch norm folded in, features computed once for each cloud.

Three rewrites, none of which changes the function:

- Batch norm in evaluation is y = a x + b per channel, so it merges into the linear map before it.
- The last shared layer takes the maximum over the points before it adds the bias and applies ReLU:
  both are monotonic, so the result is the same without 750 x 1024 additions.
- The first layer of the head splits into the columns for the features, applied once for each cloud, and
  those for the grasp, applied once for each grasp.

The head takes all grasps of a call at once. Their number may change the last bits of a prediction, by the order in which
BLAS adds; equal calls give equal bits.

It is NumPy alone. The network as torch's modules, which a robot does not need, is `foretouch_lab.learning.network`.

Shapes: N points, C channels, F features, K grasps, G grasp numbers, M outputs.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from foretouch.models.network.config import ModelConfig
from foretouch.types import AnyArray, Float32

_NORM = ("weight", "bias", "running_mean", "running_var")
_EPSILON = 1e-5  # that torch's batch norm adds to the variance


def tensor_shapes(config: ModelConfig) -> dict[str, tuple[int, ...]]:
    """Shapes of all tensors of a network by name; all are float32 but `num_batches_tracked`, which are int64."""
    shapes: dict[str, tuple[int, ...]] = dict.fromkeys(("target_mean", "target_scale"), (config.output_size,))

    def add(prefix: str, widths: Sequence[int], *, norm: bool = True) -> None:
        for k, (inputs, outputs) in enumerate(pairwise(widths)):
            shapes[f"{prefix}.{k}.linear.weight"], shapes[f"{prefix}.{k}.linear.bias"] = (outputs, inputs), (outputs,)
            if norm:
                shapes.update({f"{prefix}.{k}.norm.{name}": (outputs,) for name in _NORM})
                shapes[f"{prefix}.{k}.norm.num_batches_tracked"] = ()

    last = [config.head_size, *config.head_widths][-1]
    shapes["output.weight"], shapes["output.bias"] = (config.output_size, last), (config.output_size,)
    add("features.layers", [config.channel_count, *config.trunk_widths])
    add("head", [config.head_size, *config.head_widths], norm=config.head_norm)
    if config.tnet:
        add("features.transform.points", [config.channel_count, *config.tnet_widths[:3]])
        add("features.transform.cloud", config.tnet_widths[2:])
        matrix = "features.transform.matrix"
        shapes[f"{matrix}.weight"], shapes[f"{matrix}.bias"] = (9, config.tnet_widths[-1]), (9,)
    return shapes


@dataclass(frozen=True, eq=False)
class _Affine:
    """x to x Wᵀ + b."""

    weight: Float32  # (out, in) float32
    bias: Float32  # (out,) float32

    def __call__(self, x: Float32) -> Float32:
        """Map (..., in) to (..., out)."""
        return np.asarray(x @ self.weight.T + self.bias, np.float32)


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
    first_grasp: Float32
    head: tuple[_Affine, ...]

    def features(self, points: Float32) -> Float32:
        """Map (N, C) float32 points of one cloud to its (F,) features."""
        if self.transform is not None:
            shared, rest = self.transform
            matrix = _chain(rest, _pooled(shared, points, relu=True)[None]).reshape(3, 3)
            points = np.concatenate([points[:, :3] @ matrix, points[:, 3:]], axis=1)
        return _pooled(self.trunk, points, relu=self.trunk_relu)

    def regress(self, features: Float32, grasps: Float32) -> Float32:
        """Map (F,) features and (K, G) grasps to (K, M) predictions [counts]; K may be 0."""
        x = grasps @ self.first_grasp.T + self.first(features)
        return _chain(self.head, _relu(x)) if self.head else x

    @property
    def output_size(self) -> int:
        """M."""
        return len((self.head[-1] if self.head else self.first).bias)


def fold(config: ModelConfig, tensors: Mapping[str, AnyArray]) -> FoldedNetwork:
    """Fold a trained network; later training of the network does not change the copy.

    Args:
        config: Its architecture.
        tensors: By the names of `tensor_shapes`. Batch norm is folded with its running statistics, as in evaluation.
    """
    tensors = {name: value.astype(np.float64) for name, value in tensors.items()}
    transform = None
    if config.tnet:
        matrix = _affine(*(tensors[f"features.transform.matrix.{name}"] for name in ("weight", "bias")))
        shared, rest = (_folded(tensors, f"features.transform.{part}") for part in ("points", "cloud"))
        transform = shared, (*rest, matrix)
    scale, mean = tensors["target_scale"], tensors["target_mean"]
    output = _affine(tensors["output.weight"] * scale[:, None], tensors["output.bias"] * scale + mean)
    first, *head = *_folded(tensors, "head"), output
    return FoldedNetwork(
        transform=transform,
        trunk=_folded(tensors, "features.layers"),
        trunk_relu=config.trunk_relu,
        first=_affine(first.weight[:, : config.feature_size], first.bias),
        first_grasp=np.ascontiguousarray(first.weight[:, config.feature_size :]),
        head=tuple(head),
    )


def _folded(tensors: Mapping[str, AnyArray], prefix: str) -> tuple[_Affine, ...]:
    """Consecutive layers, in float32, with their batch norms merged in double precision."""
    layers: list[_Affine] = []
    while (name := f"{prefix}.{len(layers)}.linear.weight") in tensors:
        weight, bias = tensors[name], tensors[f"{prefix}.{len(layers)}.linear.bias"]
        norm = f"{prefix}.{len(layers)}.norm."
        if f"{norm}weight" in tensors:
            gain, shift, mean, variance = (tensors[norm + part] for part in _NORM)
            scale = gain / np.sqrt(variance + _EPSILON)
            weight, bias = weight * scale[:, None], (bias - mean) * scale + shift
        layers.append(_affine(weight, bias))
    return tuple(layers)


def _affine(weight: AnyArray, bias: AnyArray) -> _Affine:
    return _Affine(np.ascontiguousarray(weight, np.float32), bias.astype(np.float32))


def _relu(x: Float32) -> Float32:
    """Set negative values to zero, in their place."""
    return np.maximum(x, 0.0, out=x)


def _pooled(layers: tuple[_Affine, ...], points: Float32, *, relu: bool) -> Float32:
    x, last = points, layers[-1]
    for layer in layers[:-1]:
        x = _relu(layer(x))
    pooled = np.asarray((x @ last.weight.T).max(axis=0) + last.bias, np.float32)
    return _relu(pooled) if relu else pooled


def _chain(layers: tuple[_Affine, ...], x: Float32) -> Float32:
    for layer in layers[:-1]:
        x = _relu(layer(x))
    return layers[-1](x)
