# SPDX-License-Identifier: Apache-2.0
"""Batch norm by moments: a linear map and the batch norm after it as one affine map, without computing its outputs.

With z = W x + b over n rows x of mean m and covariance C (of K columns, K small), batch norm in training is::

    E[z] = W m + b        Var[z] = diag(W C Wᵀ)        s = γ / sqrt(Var[z] + ε)
    y = s (z - E[z]) + β = W' x + b'       with       W' = diag(s) W,    b' = β - s (W m)

(Ioffe and Szegedy 2015, algorithm 1, with the statistics propagated through the linear map.) The n rows are read once,
for m and C, and everything else is matrices of K columns. b cancels, so its gradient is exactly zero.

The gradient, for upstream g_W' and g_b'::

    g_s = rowsum(g_W' ∘ W) - g_b' ∘ (W m)      g_β = g_b'      g_γ = g_s / sqrt(Var + ε)
    g_v = -½ g_s ∘ s / (Var + ε)
    g_W = diag(s) g_W' - (s ∘ g_b') mᵀ + 2 diag(g_v) W C
    g_C = Wᵀ diag(g_v) W                       g_m = -Wᵀ (s ∘ g_b')
    g_x = (2/n) (x - m) g_C + g_m / n

The dense part of batch norm's gradient, -mean(g) - x̂ mean(g x̂) in each of the n x F outputs, is the last line: one
product with a K x K matrix. Functions that control the running statistics of a network follow at the end.

Shapes: B clouds, N points, n = B N rows, K inputs, F outputs.
"""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Any, TypeAlias

import torch
from torch import Tensor, nn
from torch.autograd.function import once_differentiable

Inputs: TypeAlias = tuple[Tensor, Tensor | None]
"""Points (B, N, C) and grasps (B, G) of one batch."""


def batch_affine(x: Tensor, linear: nn.Linear, norm: nn.BatchNorm1d) -> tuple[Tensor, Tensor]:
    """Weight and bias of a linear map with batch norm in training; updates the running statistics as torch does.

    Small matrices are computed in float64; sums over rows in the dtype of `x`, centred, cloud by cloud.

    Args:
        x: (B, N, K) floating. Second derivatives are not supported.
        linear: K to F.
        norm: Of F channels, with weight and bias.

    Returns:
        (F, K) and (F,), dtype of `linear`.
    """
    weight, bias, mean, variance, count = _BatchAffine.apply(  # type: ignore[no-untyped-call]
        x, linear.weight, linear.bias, norm.weight, norm.bias, norm.eps
    )
    update_statistics(norm, mean, variance, float(count))
    return weight, bias


@torch.no_grad()
def update_statistics(norm: nn.BatchNorm1d, mean: Tensor, variance: Tensor, count: float) -> None:
    """Update the running statistics as `torch.nn.BatchNorm1d` does, with the unbiased variance of `count` rows."""
    if norm.running_mean is None or norm.running_var is None or norm.num_batches_tracked is None:
        return
    norm.num_batches_tracked.add_(1)
    share = 1.0 / float(norm.num_batches_tracked) if norm.momentum is None else norm.momentum
    norm.running_mean.lerp_(mean, share)
    norm.running_var.lerp_(variance * (count / max(count - 1.0, 1.0)), share)


def _moments(x: Tensor) -> tuple[Tensor, Tensor, float]:
    """Mean (K,) and covariance (K, K), divided by n, in float64, and n."""
    count = float(x.shape[0] * x.shape[1])
    shift = x.mean(dim=(0, 1))
    centred = x - shift  # otherwise the covariance would be the small difference of large numbers
    rest = centred.sum(dim=(0, 1)).double() / count
    spread = torch.bmm(centred.transpose(1, 2), centred).sum(dim=0, dtype=torch.float64) / count
    spread = spread - torch.outer(rest, rest)
    return shift.double() + rest, spread, count


class _BatchAffine(torch.autograd.Function):
    """The two maps of the module's docstring, with its symbols."""

    @staticmethod
    def forward(
        ctx: Any, x: Tensor, weight: Tensor, bias: Tensor, gamma: Tensor, beta: Tensor, eps: float
    ) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
        mean, covariance, count = _moments(x)
        w = weight.double()
        through, spread = w @ mean, w @ covariance
        variance = (spread * w).sum(dim=1).clamp_(min=0.0)
        root = torch.sqrt(variance + eps)
        scale = gamma.double() / root
        ctx.save_for_backward(x, weight, mean, spread, through, root, scale)
        ctx.count = count
        means, variances = (through + bias).to(weight.dtype), variance.to(weight.dtype)
        number = torch.tensor(count, dtype=torch.float64)
        ctx.mark_non_differentiable(means, variances, number)
        own, bias = (w * scale[:, None]).to(weight.dtype), (beta - scale * through).to(weight.dtype)
        return own, bias, means, variances, number

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, g_weight: Tensor, g_bias: Tensor, *_: None) -> tuple[Tensor | None, ...]:
        x, weight, mean, spread, through, root, scale = ctx.saved_tensors
        w, g_w, g_b = weight.double(), g_weight.double(), g_bias.double()
        g_scale = (g_w * w).sum(dim=1) - g_b * through
        g_variance = -0.5 * g_scale * scale / root.square()
        own = g_w * scale[:, None] - torch.outer(scale * g_b, mean) + 2.0 * g_variance[:, None] * spread
        g_x = None
        if ctx.needs_input_grad[0]:
            g_covariance = w.T @ (g_variance[:, None] * w)
            g_mean = -(scale * g_b) @ w
            turn = g_covariance * (2.0 / ctx.count)
            row = g_mean / ctx.count - mean @ turn
            g_x = torch.addmm(row.to(x.dtype), x.flatten(0, 1), turn.to(x.dtype)).view_as(x)
        to = weight.dtype
        return g_x, own.to(to), torch.zeros_like(scale, dtype=to), (g_scale / root).to(to), g_b.to(to), None


def freeze(net: nn.Module) -> None:
    """Training mode for all but batch norm, which keeps its statistics: samples of a batch stay independent."""
    net.train()
    for norm in _norms(net):
        norm.eval()


@torch.no_grad()
def calibrate(net: nn.Module, batches: Iterable[Inputs]) -> None:
    """Set the statistics to their plain mean over some batches of clouds and grasps.

    Args:
        net: Its weights and mode are unchanged.
        batches: Points (B, N, C) and grasps (B, G) or None, with B of at least 2.
    """
    was_training = {module: module.training for module in net.modules()}
    momenta = {norm: norm.momentum for norm in _norms(net)}
    for norm in momenta:
        norm.reset_running_stats()
        norm.momentum = None  # makes the running statistics a plain mean
    net.train()
    for points, grasps in batches:
        net(points, grasps)
    for norm, momentum in momenta.items():
        norm.momentum = momentum
    for module, mode in was_training.items():
        module.training = mode


@contextmanager
def statistics_kept(net: nn.Module) -> Iterator[None]:
    """Context in which batch norm in training mode normalises by the batch but keeps its running statistics."""
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
