# SPDX-License-Identifier: Apache-2.0
"""The plain composition that the quick way is compared with: linear map, torch's batch norm, ReLU, maximum."""

from collections.abc import Iterator
from contextlib import contextmanager

import torch
from torch import Tensor, nn

from foretouch_lab.learning.network import pointnet
from foretouch_lab.learning.network.pointnet import Layer


def _layer(layer: Layer, x: Tensor) -> Tensor:
    y = layer.linear(x)
    if layer.norm is not None:
        y = layer.norm(y.flatten(0, -2)).view_as(y)
    return torch.relu(y)


def _pool(layers: nn.Sequential, points: Tensor, _precision: torch.dtype) -> Tensor:
    for layer in layers:
        points = _layer(layer, points)
    return points.amax(dim=1)


@contextmanager
def plain_composition() -> Iterator[None]:
    """Within, every PointNet of the package is computed the plain way, on the same weights."""
    forward, pool = Layer.forward, pointnet.pool
    Layer.forward, pointnet.pool = _layer, _pool  # type: ignore[method-assign,assignment]
    try:
        yield
    finally:
        Layer.forward, pointnet.pool = forward, pool  # type: ignore[method-assign]
