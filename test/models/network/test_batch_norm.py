# SPDX-License-Identifier: Apache-2.0
"""Batch norm by moments against torch's own: values, every gradient, running statistics."""

import multiprocessing
from pathlib import Path

import pytest
import torch
from torch import nn
from torch.nn import functional

from foretouch.models.network.batch_norm import batch_affine, synced_norm

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


def both_ways(x: torch.Tensor, total) -> list[torch.Tensor]:
    """Of points, then of one row a cloud; the gradients of points and weights."""
    linear, norm = pair(F64)
    later = pair(F64, 9, 9)
    x = x.clone().requires_grad_()
    if total is None:
        pooled = plain(x, linear, norm).amax(dim=1)
        y = later[1](later[0](pooled))
    else:
        pooled = functional.linear(x, *batch_affine(x, linear, norm, total)).amax(dim=1)
        y = synced_norm(later[0](pooled), later[1], total)
    weights = [*linear.parameters(), *norm.parameters(), *later[0].parameters(), *later[1].parameters()]
    slopes = torch.linspace(-1.0, 1.0, 9, dtype=F64)
    found = torch.autograd.grad((y.square() * slopes).sum(), [x, *weights])
    return [*found, norm.running_mean, norm.running_var, later[1].running_mean, later[1].running_var]


def run_rank(rank: int, folder: str) -> None:
    torch.set_num_threads(1)
    torch.distributed.init_process_group("gloo", init_method=f"file://{folder}/meet", rank=rank, world_size=2)

    def total(value: torch.Tensor) -> torch.Tensor:
        value = value.detach().clone()
        torch.distributed.all_reduce(value)
        return value

    share = slice(0, 3) if rank == 0 else slice(3, 8)  # unequal shares
    x_slope, *slopes = both_ways(cloud(F64, 8, 30, 6)[share], total)
    weights, statistics = slopes[:8], slopes[8:]
    whole = [total(slope) for slope in weights]
    Path(folder, f"{rank}").write_bytes(
        torch.cat([t.flatten() for t in (x_slope, *whole, *statistics)]).numpy().tobytes()
    )
    torch.distributed.destroy_process_group()


@pytest.mark.slow
def test_two_processes_share_their_statistics(tmp_path: Path) -> None:
    workers = [multiprocessing.get_context("fork").Process(target=run_rank, args=(r, str(tmp_path))) for r in range(2)]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join(60)
    assert [worker.exitcode for worker in workers] == [0, 0]
    x_slope, *rest = both_ways(cloud(F64, 8, 30, 6), None)
    for rank, share in enumerate((slice(0, 3), slice(3, 8))):
        found = torch.frombuffer(bytearray((tmp_path / str(rank)).read_bytes()), dtype=F64)
        expected = torch.cat([t.flatten() for t in (x_slope[share], *rest)])
        torch.testing.assert_close(found, expected, rtol=1e-8, atol=1e-9)
