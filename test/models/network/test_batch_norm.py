# SPDX-License-Identifier: Apache-2.0
"""Batch norm by moments against torch's own: values, every gradient, running statistics."""

import pytest
import torch
from torch import nn
from torch.nn import functional

from foretouch.models.network.batch_norm import batch_affine

F64 = torch.float64


def pair(dtype: torch.dtype, inputs: int = 6, outputs: int = 9) -> tuple[nn.Linear, nn.BatchNorm1d]:
    """A linear map and a batch norm with negative and zero scales."""
    generator = torch.Generator().manual_seed(3)
    linear, norm = nn.Linear(inputs, outputs).to(dtype), nn.BatchNorm1d(outputs).to(dtype)
    with torch.no_grad():
        for parameter in (*linear.parameters(), *norm.parameters()):
            parameter.copy_(torch.randn(parameter.shape, generator=generator))
        norm.weight[1] = 0.0
    return linear, norm


def cloud(dtype: torch.dtype, *shape: int) -> torch.Tensor:
    """Far from zero, as activations after a ReLU are."""
    return (torch.randn(*shape, generator=torch.Generator().manual_seed(8), dtype=F64) + 3.0).to(dtype)


def plain(x: torch.Tensor, linear: nn.Linear, norm: nn.BatchNorm1d) -> torch.Tensor:
    return norm(linear(x).flatten(0, 1)).view(*x.shape[:2], -1)


def quick(x: torch.Tensor, linear: nn.Linear, norm: nn.BatchNorm1d) -> torch.Tensor:
    return functional.linear(x, *batch_affine(x, linear, norm))


def results(way, x: torch.Tensor, dtype: torch.dtype, momentum: float | None = 0.1) -> list[torch.Tensor]:
    """Output, gradients and running statistics of two batches."""
    linear, norm = pair(dtype, x.shape[2], 9)
    norm.momentum = momentum
    with torch.no_grad():
        way(x * 0.5 + 1.0, linear, norm)
    x = x.clone().requires_grad_()
    y = way(x, linear, norm)
    slopes = torch.randn(y.shape, generator=torch.Generator().manual_seed(1), dtype=F64).to(dtype)
    gradients = torch.autograd.grad((y * slopes).sum(), [x, *linear.parameters(), *norm.parameters()])
    assert norm.num_batches_tracked == 2
    return [y, *gradients, norm.running_mean, norm.running_var]


@pytest.mark.parametrize("momentum", [0.1, 0.0, None], ids=str)
def test_equal_to_torch_in_double(momentum: float | None) -> None:
    x = cloud(F64, 4, 30, 6)
    for one, two in zip(results(quick, x, F64, momentum), results(plain, x, F64, momentum), strict=True):
        torch.testing.assert_close(one, two, rtol=1e-9, atol=1e-10)


@pytest.mark.parametrize("inputs", [3, 64, 128])
def test_as_near_to_the_truth_as_torch_in_single(inputs: int) -> None:
    """Within 1e-5 of the size of each result: float32 against torch's own batch norm in float64."""
    x = torch.relu(cloud(F64, 8, 400, inputs) - 3.0)
    truth = results(plain, x, F64)
    for one, two in zip(results(quick, x.float(), torch.float32), truth, strict=True):
        # The gradient of the bias is zero in exact arithmetic: nothing to be relative to.
        assert float((one - two).detach().abs().max()) <= 1e-5 * max(1.0, float(two.detach().abs().max()))


def test_a_channel_that_never_moves_stays_finite() -> None:
    x = torch.full((3, 40, 6), 0.7)
    assert all(torch.isfinite(value).all() for value in results(quick, x, torch.float32))
