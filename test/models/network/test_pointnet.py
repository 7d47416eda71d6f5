# SPDX-License-Identifier: Apache-2.0
"""The quick way to pooled features against the plain one."""

import pytest
import torch

from foretouch.models.network.config import ModelConfig
from foretouch_lab.learning.network import pointnet
from foretouch_lab.learning.network.pointnet import PointNetFeatures, batch_affine, freeze, make_layers, pool, winners

F64 = torch.float64


def after_two_batches(way, x: torch.Tensor, momentum: float | None = 0.1) -> list[torch.Tensor]:
    """Output, gradients and running statistics of a linear map with a batch norm of negative and zero scales."""
    generator = torch.Generator().manual_seed(3)
    linear, norm = (one.to(x.dtype) for one in (torch.nn.Linear(x.shape[2], 9), torch.nn.BatchNorm1d(9)))
    with torch.no_grad():
        for parameter in (*linear.parameters(), *norm.parameters()):
            parameter.copy_(torch.randn(parameter.shape, generator=generator, dtype=F64))
        norm.weight[1] = 0.0
        norm.momentum = momentum
        way(x * 0.5 + 1.0, linear, norm)
    x = x.clone().requires_grad_()
    y = way(x, linear, norm)
    slopes = torch.randn(y.shape, generator=generator, dtype=F64).to(x.dtype)
    gradients = torch.autograd.grad((y * slopes).sum(), [x, *linear.parameters(), *norm.parameters()])
    assert norm.num_batches_tracked == 2
    return [y, *gradients, norm.running_mean, norm.running_var]


@pytest.mark.parametrize("momentum", [0.1, None], ids=str)
@pytest.mark.parametrize(("dtype", "inputs"), [(F64, 6), (torch.float32, 128)], ids=str)
def test_batch_norm_by_moments_is_that_of_torch_in_double(dtype, inputs: int, momentum: float | None) -> None:
    x = torch.randn(8, 400, inputs, generator=torch.Generator().manual_seed(8), dtype=F64) + 3.0
    x = x if dtype is F64 else torch.relu(x - 3.0)  # far from zero, or as after a ReLU

    def quick(x, linear, norm):
        return torch.nn.functional.linear(x, *batch_affine(x, linear, norm))

    def plain(x, linear, norm):
        return norm(linear(x).flatten(0, 1)).view(*x.shape[:2], -1)

    nearness = (
        1e-9 if dtype is F64 else 5e-5
    )  # of float32, less what is lost where a channel's mean exceeds its deviation
    pairs = zip(after_two_batches(quick, x.to(dtype), momentum), after_two_batches(plain, x, momentum), strict=True)
    for one, two in pairs:  # the gradient of the bias is zero: nothing to be relative to
        assert float((one - two).detach().abs().max()) <= nearness * max(1.0, float(two.detach().abs().max()))
    still = after_two_batches(quick, torch.full((3, 40, 6), 0.7))  # channels that never move
    assert all(torch.isfinite(value).all() for value in still)


@pytest.mark.parametrize("precision", [torch.float32, torch.bfloat16])
def test_the_winner_is_the_largest_and_a_coarse_search_finds_a_near_equal_one(precision: torch.dtype) -> None:
    generator = torch.Generator().manual_seed(1)
    x, weight = torch.randn(5, 750, 8, generator=generator), torch.randn(33, 8, generator=generator)
    every = x @ weight.T
    found = every.gather(1, winners(x, weight, precision)[:, None])[:, 0]
    short = every.amax(dim=1) - found
    assert float(short.min()) >= 0.0
    assert float(short.max()) <= (1e-5 if precision is torch.float32 else 2.0**-6 * float(every.max()))
    x[2, 31, 0] = torch.nan
    pooled = pool(make_layers([8, 33], norm=False), x)
    assert torch.isnan(pooled).all(dim=1).tolist() == [False, False, True, False, False]


def layers(*, norm: bool = True) -> torch.nn.Sequential:
    torch.manual_seed(4)
    made = make_layers([3, 8, 16], norm=norm).double().train()
    for _ in range(3):
        made(torch.randn(5, 20, 3, dtype=F64))
    return made.eval()


def test_the_quick_way_has_its_gradient_and_is_taken_for_large_batches(monkeypatch) -> None:
    net = layers()
    points = torch.randn(2, 10, 3, dtype=F64).requires_grad_()
    assert torch.autograd.gradcheck(lambda x: pool(net, x), points)
    net = layers().train()
    found = [net[-1].map_of(torch.randn(2, size, 8, dtype=F64)) is None for size in (10, 40_000)]
    assert found == [True, False]
    monkeypatch.setattr(pointnet, "_worth_moments", lambda *_: True)
    assert net[-1].map_of(torch.randn(2, 8, dtype=F64)) is None  # rows of a head, not points


def plain_features(net: PointNetFeatures, points: torch.Tensor) -> torch.Tensor:
    """The plain composition: every layer over every point, torch's own batch norm, then the maximum."""

    def run(stack: torch.nn.Module, x: torch.Tensor) -> torch.Tensor:
        for layer in stack:
            x = layer.linear(x)
            x = torch.relu(layer.norm(x.flatten(0, -2)).view_as(x))
        return x

    if net.transform is not None:
        matrix = net.transform.matrix(run(net.transform.cloud, run(net.transform.points, points).amax(dim=1)))
        points = torch.cat([points[..., :3] @ matrix.view(-1, 3, 3), points[..., 3:]], dim=-1)
    return run(net.layers, points).amax(dim=1)


def features_and_gradients(
    way, dtype: torch.dtype, mode: str, changes: dict[str, object]
) -> tuple[list[torch.Tensor], dict[str, torch.Tensor]]:
    torch.manual_seed(2)
    config = ModelConfig(channels="xyz+normals", tnet_widths=(16, 32, 64, 32, 16), trunk_widths=(16, 32, 64))
    net = PointNetFeatures(config.replace(**changes))
    for layer in (module for module in net.modules() if isinstance(module, torch.nn.BatchNorm1d)):
        torch.nn.init.normal_(layer.weight)  # negative scales too
    points = torch.randn(6, 60, 6)
    net = net.to(dtype).train()
    if mode == "frozen":
        net(points.to(dtype))
        freeze(net)
    x = points.to(dtype).requires_grad_()
    features = way(net, x)
    slopes = torch.linspace(-1.0, 2.0, features.numel(), dtype=dtype).view_as(features)
    gradients = torch.autograd.grad((features * slopes).sum(), [x, *net.parameters()])
    return [features, *gradients], net.state_dict()


@pytest.mark.parametrize("changes", [{}, {"tnet": False, "trunk_widths": (32, 16)}], ids=str)
@pytest.mark.parametrize("mode", ["frozen", "training"])
@pytest.mark.parametrize("dtype", [torch.float64, torch.float32], ids=str)
def test_the_whole_network_equals_the_plain_composition(monkeypatch, dtype, mode, changes) -> None:
    monkeypatch.setattr(pointnet, "_worth_moments", lambda _rows, linear: linear.in_features <= linear.out_features)
    quick, quick_state = features_and_gradients(lambda net, x: net(x), dtype, mode, changes)
    plain, plain_state = features_and_gradients(plain_features, F64, mode, changes)
    nearness = 1e-10 if dtype is F64 else 1e-5
    largest = max(float(two.detach().norm()) for two in plain[1:])  # the bias before a batch norm has none of its own
    for one, two in zip(quick, plain, strict=True):
        assert float((one - two).detach().norm()) <= nearness * max(0.1 * largest, float(two.detach().norm()))
    for name, value in quick_state.items():
        torch.testing.assert_close(value.double(), plain_state[name].double(), rtol=nearness, atol=nearness)
