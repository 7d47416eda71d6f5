# SPDX-License-Identifier: Apache-2.0
"""The quick way to pooled features against the plain one."""

import pytest
import torch

from foretouch.models.network import pointnet
from foretouch.models.network.batch_norm import freeze
from foretouch.models.network.config import ModelConfig
from foretouch.models.network.pointnet import PointNetFeatures, make_layers, pool

F64 = torch.float64


def layers(*, norm: bool = True) -> torch.nn.Sequential:
    torch.manual_seed(4)
    made = make_layers([3, 8, 16], norm=norm).double().train()
    for _ in range(3):
        made(torch.randn(5, 20, 3, dtype=F64))
    return made.eval()


@pytest.mark.parametrize("training", [True, False])
def test_features_without_relu_are_negative_where_all_points_are(training: bool) -> None:
    torch.manual_seed(0)
    config = ModelConfig(n_points=8, tnet=False, trunk_widths=(8, 32))
    with_relu, without = PointNetFeatures(config), PointNetFeatures(config.replace(trunk_relu=False))
    without.load_state_dict(with_relu.state_dict())
    points = torch.randn(2, 8, 3)
    features = without.train(training)(points)
    assert training or bool((features < 0.0).any())  # batch norm of 16 points makes some of them positive
    torch.testing.assert_close(torch.relu(features), with_relu.train(training)(points))


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


@pytest.mark.parametrize("changes", [{}, {"tnet": False}, {"trunk_widths": (32, 16)}], ids=str)
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
