# SPDX-License-Identifier: Apache-2.0
"""The quick way to pooled features against the plain one."""

import pytest
import torch

from foretouch.models.pointnet import InputTransform, make_layers, pool

F64 = torch.float64


def layers(*, norm: bool = True) -> torch.nn.Sequential:
    torch.manual_seed(4)
    made = make_layers([3, 8, 16], norm=norm).double().train()
    for _ in range(3):
        made(torch.randn(5, 20, 3, dtype=F64))
    return made.eval()


def gradients(net: torch.nn.Module, features: torch.Tensor, points: torch.Tensor) -> list[torch.Tensor]:
    slopes = torch.linspace(-1.0, 2.0, features.numel(), dtype=F64).view_as(features)
    return list(torch.autograd.grad((features * slopes).sum(), [points, *net.parameters()]))


@pytest.mark.parametrize("norm", [True, False])
def test_values_and_gradients_are_those_of_the_plain_way(norm: bool) -> None:
    net = layers(norm=norm)
    points = torch.randn(4, 30, 3, dtype=F64).requires_grad_()
    with torch.no_grad():
        plain_value = net(points).amax(dim=1)
    x = points
    for layer in net:  # as the layers are in training: linear, batch norm, ReLU
        x = layer.linear(x)
        x = torch.relu(x if layer.norm is None else layer.norm(x.flatten(0, 1)).view_as(x))
    plain, quick = x.amax(dim=1), pool(net, points)
    torch.testing.assert_close(plain, plain_value)
    torch.testing.assert_close(quick, plain)
    # A feature that is zero everywhere ties at all points, but has no gradient either way.
    for one, two in zip(gradients(net, quick, points), gradients(net, plain, points), strict=True):
        torch.testing.assert_close(one, two, rtol=1e-9, atol=1e-12)


def test_batch_norm_in_training_still_sees_every_point() -> None:
    net = layers().train()
    points = torch.randn(4, 30, 3, dtype=F64)
    before = net[-1].norm.running_mean.clone()
    torch.testing.assert_close(pool(net, points), net(points).amax(dim=1))
    assert not torch.equal(net[-1].norm.running_mean, before)


def test_the_quick_way_can_be_differentiated_twice() -> None:
    net = layers()
    points = torch.randn(2, 10, 3, dtype=F64).requires_grad_()
    assert torch.autograd.gradcheck(lambda x: pool(net, x), points)
    (slope,) = torch.autograd.grad(pool(net, points).square().sum(), points, create_graph=True)
    (second,) = torch.autograd.grad(slope.square().sum(), net[0].linear.weight)
    assert float(second.abs().max()) > 0


def test_the_transform_gives_the_same_with_and_without_gradients() -> None:
    torch.manual_seed(0)
    transform = InputTransform(6, (8, 8, 16, 8, 8)).eval()
    torch.nn.init.normal_(transform.matrix.weight)
    points = torch.randn(3, 40, 6)
    with torch.no_grad():
        plain = transform(points)
    torch.testing.assert_close(transform(points), plain)
