# SPDX-License-Identifier: Apache-2.0
"""The winning points against torch's argmax, and what a search of low precision may change."""

import pytest
import torch

from foretouch.models.network import pointnet as pooling
from foretouch.models.network.pointnet import pooled_affine, winners


def made(size: int, dtype: torch.dtype = torch.float32) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(size)
    x = torch.randn(5, size, 8, generator=generator).to(dtype)
    return x, torch.randn(33, 8, generator=generator).to(dtype), torch.randn(33, generator=generator).to(dtype)


@pytest.mark.parametrize("size", [1, 24, 25, 50, 51, 99, 128, 750])
@pytest.mark.parametrize("entries", [1, 10_000, 2**20])
def test_the_winner_is_the_largest(monkeypatch, size: int, entries: int) -> None:
    monkeypatch.setitem(pooling._ENTRIES, "cpu", entries)
    x, weight, _ = made(size, torch.float64)
    assert torch.equal(winners(x, weight), (x @ weight.T).argmax(dim=1))


def test_a_coarse_search_takes_the_exact_value_of_a_near_equal_point_and_nan_comes_through() -> None:
    x, weight, bias = made(750)
    every = torch.relu(x @ weight.T + bias)
    coarse = pooled_affine(x, weight, bias, torch.bfloat16)
    exact = every.amax(dim=1)
    assert not torch.equal(winners(x, weight, torch.bfloat16), winners(x, weight))
    assert float((every - coarse[:, None]).abs().amin(dim=1).max()) < 1e-5  # the value of some point
    assert float((exact - coarse).min()) > -1e-5
    assert float((exact - coarse).max()) < 2.0**-6 * float(exact.max())  # 8 bits, of inputs and of the sum
    assert torch.equal(winners(x, weight, torch.float64), winners(x, weight))  # never more than the inputs have
    x, weight, bias = made(60)
    x[2, 31, 0] = torch.nan
    pooled = pooled_affine(x, weight, bias)
    assert torch.isnan(pooled[2]).all()
    assert torch.isfinite(pooled[[0, 1, 3, 4]]).all()


def test_products_at_the_winners_have_their_gradients() -> None:
    x, weight, _ = (value.requires_grad_() for value in made(20, torch.float64))
    rows = pooling._rows(winners(x, weight), 20)
    inputs = (x.flatten(0, 1).detach().requires_grad_(), weight)

    def products(*given: torch.Tensor) -> torch.Tensor:
        return pooling.products_at(*given, rows)

    assert torch.autograd.gradcheck(products, inputs)


@pytest.mark.parametrize("inputs", [3, 16, 40])
def test_compiled_and_by_torch(inputs: int) -> None:
    """The same winners, also among equal values, and products and gradients that differ by rounding."""
    generator = torch.Generator().manual_seed(inputs)
    x = torch.randn(3, 110, inputs, generator=generator)
    x = torch.cat([x, x[:, :50]], dim=1).requires_grad_()
    weight = torch.randn(70, inputs, generator=generator).requires_grad_()
    for precision in (torch.float32, torch.bfloat16):
        winner = (x.to(precision) @ weight.T.to(precision)).argmax(dim=1)
        assert torch.equal(winners(x, weight, precision), winner)
        pooled = pooled_affine(x, weight, torch.zeros(70), precision)
        plain = torch.relu((x[torch.arange(3)[:, None], winner] * weight).sum(dim=-1))
        gradients = (torch.autograd.grad(one.square().sum(), (x, weight)) for one in (pooled, plain))
        torch.testing.assert_close(pooled, plain, rtol=1e-5, atol=1e-5)
        for one, two in zip(*gradients, strict=True):
            torch.testing.assert_close(one, two, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("precision", [torch.float32, torch.bfloat16])
def test_layers_computed_at_the_winners_alone(monkeypatch, precision: torch.dtype) -> None:
    torch.manual_seed(0)
    layers = pooling.make_layers([4, 16, 96]).eval()
    points = torch.randn(3, 90, 4, requires_grad=True)
    inputs = [points, *layers.parameters()]
    alone = pooling.pool(layers, points, precision)
    monkeypatch.setattr(pooling, "_ENOUGH_VALUES", 1)
    from_winners = pooling.pool(layers, points, precision)
    torch.testing.assert_close(from_winners, alone, rtol=1e-5, atol=1e-6)
    gradients = (torch.autograd.grad(one.square().sum(), inputs) for one in (from_winners, alone))
    for one, two in zip(*gradients, strict=True):
        torch.testing.assert_close(one, two, rtol=1e-4, atol=1e-5)
