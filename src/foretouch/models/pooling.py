# SPDX-License-Identifier: Apache-2.0
"""The maximum over the points after an affine map, whose gradient touches the winning points alone.

The last shared layer of a PointNet takes most of its time, 128 to 1024 values at each of 750 points, and all but one
value a feature is thrown away. So the winners are searched without a graph, in blocks that stay in the cache, and each
feature is computed once more at its winner, with a graph. Value and gradient are those of the plain way, but for
rounding; the gradient costs F products a cloud instead of F N.

Shapes: B clouds, N points, K inputs, F features.
"""

from __future__ import annotations

from typing import Final

import torch
from torch import Tensor

__all__ = ["pooled_affine", "winners"]

_BLOCK: Final = 25
"""Points that are looked at together: the winning block is found first, for a maximum is much faster than its place."""

_ENTRIES: Final = {"cpu": 2**20, "cuda": 2**27}
"""Values held at a time: what a cache holds, or what a GPU's memory may be asked for."""


def pooled_affine(x: Tensor, weight: Tensor, bias: Tensor, precision: torch.dtype = torch.float32) -> Tensor:
    """(B, F): max over the points of relu(x Wᵀ + b).

    Args:
        x: (B, N, K) floating.
        weight: (F, K).
        bias: (F,).
        precision: Of the search, if lower than that of `x`. What wins by less than its rounding may then lose to a
            near equal; values and gradients stay those of the point that was taken, in the dtype of `x`.
    """
    winner = winners(x, weight, precision)
    clouds, size = x.shape[:2]
    rows = (winner + size * torch.arange(clouds, device=x.device)[:, None]).flatten()
    chosen = x.flatten(0, 1).index_select(0, rows).view(clouds, -1, x.shape[2])
    return torch.relu((chosen * weight).sum(dim=-1) + bias)  # ReLU keeps order, so it may follow the maximum


@torch.no_grad()
def winners(x: Tensor, weight: Tensor, precision: torch.dtype = torch.float32) -> Tensor:
    """(B, F) int64: the point with the largest x Wᵀ; arguments as of `pooled_affine`."""
    if precision.itemsize < x.dtype.itemsize:
        x, weight = x.to(precision), weight.to(precision)
    across = weight.T.contiguous()
    at_once = max(1, _ENTRIES.get(x.device.type, 2**20) // max(1, x.shape[1] * len(weight)))
    return torch.cat([_winners(part, across) for part in torch.split(x, at_once)])


def _winners(x: Tensor, across: Tensor) -> Tensor:
    clouds, size = x.shape[:2]
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
    rest, place = values[:, whole:].max(dim=1)
    return torch.where(rest > most, whole + place, winner)
