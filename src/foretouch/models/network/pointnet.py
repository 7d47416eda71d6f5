# SPDX-License-Identifier: Apache-2.0
"""PointNet features: one vector for a cloud, independent of the order of its points.

    points (B, N, C) ─ T-Net ─► (B, N, C) ─ shared layers 64, 128, 1024 ─► (B, N, F) ─ max over N ─► (B, F)

After Qi et al. 2017, the network that P1 and P2 build on. Points are rows and the shared layers are
plain linear maps, which is the same function as the usual 1-D convolutions of kernel 1 and faster on CPUs.
In evaluation each batch norm is an affine map that `foretouch.models.network.folding` merges into its layer.

The last shared layer takes most of the time, 128 to 1024 values at each of 750 points, and the maximum discards all but
one value of each feature. In training the winning points are therefore searched without a graph, in blocks that fit the
cache, and each feature is computed once more at its winner, with a graph: by `pooled_affine`, or, where no layer needs
the statistics of its batch, by `pool` from the coordinates of the winners alone. Value and gradient equal those of the
plain computation except for rounding; the gradient costs F products a cloud instead of F N. Maxima, and products and
gradients at the winners, are compiled (`kernels/pooled.c`): torch would copy the inputs of every winner.

Shapes: B clouds, N points, C channels of the cloud, K inputs of a layer, F features.
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any, Final, TypeAlias

import numpy as np
import torch
from torch import Tensor, nn
from torch.autograd.function import once_differentiable
from torch.nn import functional

from foretouch.errors import ModelError
from foretouch.kernels import Kernel
from foretouch.models.network.batch_norm import batch_affine
from foretouch.models.network.config import ModelConfig

_LARGEST: Final = {
    torch.float32: Kernel("largest_float32", np.float32, int, int, int, np.int64),
    torch.bfloat16: Kernel("largest_bfloat16", np.int16, int, int, int, np.int64),
}
_PRODUCTS: Final = {
    torch.float32: Kernel("winner_products_float32", *[np.float32] * 2, np.int64, int, int, int, np.float32),
    torch.float64: Kernel("winner_products_float64", *[np.float64] * 2, np.int64, int, int, int, np.float64),
}
_GRADIENTS: Final = {
    torch.float32: Kernel("winner_gradients_float32", *[np.float32] * 3, np.int64, *[int] * 5, *[np.float32] * 2),
    torch.float64: Kernel("winner_gradients_float64", *[np.float64] * 3, np.int64, *[int] * 5, *[np.float64] * 2),
}

_BLOCK: Final = 25
"""Points searched together: the winning block is found first, because a maximum is much faster than its index."""

_ENTRIES: Final = {"cpu": 2**20, "cuda": 2**27}
"""Values computed at a time: as many as a CPU's cache holds, or as a GPU's memory allows."""

_BYTES: Final = 3 * 2**18
_COLUMNS: Final = 64
"""The compiled search computes so many features at a time that their values stay in a core's cache."""


def pooled_affine(
    x: Tensor, weight: Tensor, bias: Tensor, precision: torch.dtype = torch.float32, *, relu: bool = True
) -> Tensor:
    """(B, F): max over the points of relu(x Wᵀ + b), or of x Wᵀ + b without `relu`.

    Args:
        x: (B, N, K) floating.
        weight: (F, K).
        bias: (F,).
        precision: Of the search, if lower than that of `x`. A point that wins by less than the rounding may then lose
            to a near equal one; values and gradients are those of the selected point, in the dtype of `x`.
        relu: Whether the layer ends in a ReLU.
    """
    pooled = products_at(x.flatten(0, 1), weight, _rows(winners(x, weight, precision), x.shape[1])) + bias
    return torch.relu(pooled) if relu else pooled  # ReLU is monotonic, so it may follow the maximum


def _rows(winner: Tensor, size: int) -> Tensor:
    """(B, F) int64: rows of the points of all clouds (B N, .) that (B, F) winners stand for."""
    return winner + size * torch.arange(len(winner), device=winner.device)[:, None]


def products_at(x: Tensor, weight: Tensor, rows: Tensor) -> Tensor:
    """(B, F): (R, K) points, in the (B, F) rows of which each feature wins, times the feature's row of (F, K) weights."""
    if x.device.type == "cpu" and x.dtype == weight.dtype and x.dtype in _PRODUCTS:
        products: Tensor = _ProductsAt.apply(x, weight, rows)  # type: ignore[no-untyped-call]
        return products
    return (_at(x, rows) * weight).sum(dim=-1)


def _at(x: Tensor, rows: Tensor) -> Tensor:
    """(B, F, K): a copy of each row."""
    return x.index_select(0, rows.flatten()).view(*rows.shape, -1)


class _ProductsAt(torch.autograd.Function):
    """The compiled form of `products_at`."""

    @staticmethod
    def forward(ctx: Any, x: Tensor, weight: Tensor, rows: Tensor) -> Tensor:
        x, weight = x.contiguous(), weight.contiguous()
        ctx.save_for_backward(x, weight, rows)
        products = x.new_empty(rows.shape)
        arrays = [one.detach().numpy() for one in (x, weight, rows)]
        _PRODUCTS[x.dtype](*arrays, *rows.shape, x.shape[1], products.numpy())
        return products

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, slope: Tensor) -> tuple[Tensor | None, Tensor | None, None]:
        x, weight, rows = ctx.saved_tensors
        g_x, g_weight = (
            torch.zeros_like(one) if need else None
            for one, need in zip((x, weight), ctx.needs_input_grad[:2], strict=True)
        )
        arrays = [one.detach().numpy() for one in (slope.contiguous(), x, weight, rows)]
        needs = [int(need) for need in ctx.needs_input_grad[:2]]
        results = [(slope.new_empty(0) if one is None else one).numpy() for one in (g_x, g_weight)]
        _GRADIENTS[x.dtype](*arrays, *rows.shape, x.shape[1], *needs, *results)
        return g_x, g_weight, None


@torch.no_grad()
def winners(x: Tensor, weight: Tensor, precision: torch.dtype = torch.float32) -> Tensor:
    """(B, F) int64: the point with the largest x Wᵀ; arguments as in `pooled_affine`."""
    if precision.itemsize < x.dtype.itemsize:
        x, weight = x.to(precision), weight.to(precision)
    compiled = _LARGEST.get(x.dtype) if x.device.type == "cpu" else None
    across = weight.T if compiled is not None else weight.T.contiguous()
    at_once = max(1, _ENTRIES.get(x.device.type, 2**20) // max(1, x.shape[1] * len(weight)))
    return torch.cat([_winners(part, across, compiled) for part in torch.split(x, at_once)])


def _winners(x: Tensor, across: Tensor, compiled: Kernel | None) -> Tensor:
    clouds, size = x.shape[:2]
    if compiled is not None:
        return _compiled_winners(x, across, compiled)
    values = (x.flatten(0, 1) @ across).view(clouds, size, -1)
    features = values.shape[2]
    blocks = size // _BLOCK
    if blocks < 2:
        return values.argmax(dim=1)
    whole = blocks * _BLOCK
    blocked = values[:, :whole].view(clouds, blocks, _BLOCK, features)
    most, block = blocked.amax(dim=2).max(dim=1)
    inside = blocked.gather(1, block[:, None, None].expand(clouds, 1, _BLOCK, features)).squeeze(1)
    winner = block * _BLOCK + inside.argmax(dim=1)
    if whole == size:
        return winner
    rest, index = values[:, whole:].max(dim=1)
    return torch.where(rest > most, whole + index, winner)


def _compiled_winners(x: Tensor, across: Tensor, compiled: Kernel) -> Tensor:
    rows, found = x.flatten(0, 1), []
    at_once = max(1, _BYTES // (len(rows) * x.element_size() * _COLUMNS)) * _COLUMNS
    room = x.new_empty(len(rows) * min(at_once, across.shape[1]))  # new memory would cost more than the product
    for part in torch.split(across, at_once, dim=1):
        values = torch.mm(rows, part, out=room[: len(rows) * part.shape[1]].view(len(rows), -1))
        winner = torch.empty((len(x), part.shape[1]), dtype=torch.int64)
        bits = values.view(torch.int16) if values.dtype == torch.bfloat16 else values
        compiled(bits.numpy(), *x.shape[:2], part.shape[1], winner.numpy())
        found.append(winner)
    return torch.cat(found, dim=1) if len(found) > 1 else found[0]


_ENOUGH_VALUES: Final = 2**19
"""Values of a layer, rows x outputs, from which batch norm by moments is faster than torch's."""

_ENOUGH_ROWS: Final = 16
"""Rows for each input from which the same holds: the matrices of the moments hold inputs² values each."""


class Layer(nn.Module):
    """Linear map, batch norm over all leading axes (or none), ReLU (or none).

    Shapes: (..., in_width) to (..., out_width).

    Attributes:
        moments: Whether batch norm in training may be computed by moments, which `torch.vmap` does not support.
    """

    moments: bool = True

    def __init__(self, in_width: int, out_width: int, *, norm: bool = True, relu: bool = True) -> None:
        super().__init__()
        self.relu = relu
        self.linear = nn.Linear(in_width, out_width)
        self.norm = nn.BatchNorm1d(out_width) if norm else None

    @property
    def affine(self) -> bool:
        """Whether the layer is an affine map and ReLU: no batch norm, or one whose statistics are fixed."""
        return self.norm is None or not self.norm.training

    def folded(self) -> tuple[Tensor, Tensor]:
        """Weight and bias of that map, with gradients to all parameters; only where the layer is `affine`."""
        if self.norm is None:
            return self.linear.weight, self.linear.bias
        mean, variance = self.norm.running_mean, self.norm.running_var
        if mean is None or variance is None:
            raise ModelError("batch norm: keeps no statistics, so it cannot be folded")
        scale = self.norm.weight / torch.sqrt(variance + self.norm.eps)
        return self.linear.weight * scale[:, None], (self.linear.bias - mean) * scale + self.norm.bias

    def map_of(self, x: Tensor) -> tuple[Tensor, Tensor] | None:
        """Weight and bias of the layer's affine map for this batch, if computing them is faster than the plain layer.

        With batch norm in training that is `batch_affine`. None where there are few rows, as in the head, or fewer
        outputs than inputs, or for prediction without gradients, for which `folding` exists.
        """
        if self.norm is None or not self.norm.training:
            return self.folded() if self.training or torch.is_grad_enabled() else None
        worth = self.moments and x.dim() == 3 and _worth_moments(x.shape[0] * x.shape[1], self.linear)
        return batch_affine(x, self.linear, self.norm) if worth else None

    def forward(self, x: Tensor) -> Tensor:
        """Apply the layer."""
        found = self.map_of(x)
        if found is not None:  # saves two passes over the points, and their gradients
            return self._activated(functional.linear(x, *found))
        y: Tensor = self.linear(x)
        if self.norm is None:
            return self._activated(y)
        rows = y.flatten(0, -2)
        return self._activated(self.norm(rows).view_as(y))

    def _activated(self, y: Tensor) -> Tensor:
        return torch.relu_(y) if self.relu else y


def _worth_moments(rows: int, linear: nn.Linear) -> bool:
    inputs, outputs = linear.in_features, linear.out_features
    return inputs <= outputs and rows * outputs >= _ENOUGH_VALUES and rows >= _ENOUGH_ROWS * inputs


def make_layers(widths: Sequence[int], *, norm: bool = True) -> nn.Sequential:
    """Layers between consecutive widths; no layer for a single width."""
    return nn.Sequential(*[Layer(a, b, norm=norm) for a, b in pairwise(widths)])


def pool(layers: nn.Sequential, points: Tensor, precision: torch.dtype = torch.float32) -> Tensor:
    """The largest value of each feature over the points, after some layers.

    Shapes: (B, N, C) to (B, F).

    Args:
        layers: At least one.
        points: The clouds.
        precision: Of the search for the winners; see `pooled_affine`.
    """
    last = layers[-1]
    maps = _affine_maps(layers, points)
    if maps:
        return _pooled_from_winners(maps, points, precision)
    hidden: Tensor = layers[:-1](points)
    found = last.map_of(hidden) if isinstance(last, Layer) else None
    if found is None or not isinstance(last, Layer):
        features: Tensor = last(hidden).amax(dim=1)
        return features
    return pooled_affine(hidden, *found, precision, relu=last.relu)


_Map: TypeAlias = tuple[Tensor, Tensor, bool]
"""Weight and bias of an affine map, and whether a ReLU follows."""


def _affine_maps(layers: nn.Sequential, points: Tensor) -> list[_Map]:
    """The maps of the layers, if features may be computed from the winners alone and that is faster; else empty."""
    if points.device.type != "cpu":
        return []
    maps: list[_Map] = []
    for layer in layers:
        found = layer.map_of(points) if isinstance(layer, Layer) and layer.affine else None
        if found is None:
            return []
        maps.append((*found, bool(layer.relu)))
    return maps if points.shape[0] * points.shape[1] * len(maps[-1][1]) >= _ENOUGH_VALUES else []


def _pooled_from_winners(maps: Sequence[_Map], points: Tensor, precision: torch.dtype) -> Tensor:
    """(B, F): as `pool`; a graph only through the points that win a feature, a third of them in P2's network."""
    weight, bias, relu = maps[-1]
    with torch.no_grad():  # cloud by cloud, which stays in the cache
        coarse = weight.to(precision) if precision.itemsize < weight.dtype.itemsize else weight
        hidden = (_chained(maps[:-1], cloud).to(coarse.dtype) for cloud in torch.split(points, 1))
        rows = _rows(torch.cat([winners(cloud, coarse) for cloud in hidden]), points.shape[1])
        wins = torch.zeros(points.shape[0] * points.shape[1], dtype=torch.int64)
        wins[rows] = 1
        among = wins.cumsum(0).sub_(1)[rows]
    x = _chained(maps[:-1], points.flatten(0, 1).index_select(0, wins.nonzero().flatten()))
    pooled = products_at(x, weight, among) + bias
    return torch.relu(pooled) if relu else pooled


def _chained(maps: Sequence[_Map], x: Tensor) -> Tensor:
    for weight, bias, relu in maps:
        x = functional.linear(x, weight, bias)
        x = torch.relu_(x) if relu else x
    return x


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
        """Features of each cloud."""
        if self.transform is not None:
            points = self.transform(points)
        return pool(self.layers, points, self.precision)
