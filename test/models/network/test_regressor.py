# SPDX-License-Identifier: Apache-2.0
"""The networks themselves: shapes, invariances and gradients."""

import torch

from foretouch.models.network.config import ModelConfig
from foretouch_lab.learning.network.networks import TouchNet


def inputs(config: ModelConfig, count: int = 4) -> tuple[torch.Tensor, torch.Tensor | None]:
    generator = torch.Generator().manual_seed(1)
    points = torch.randn(count, config.n_points, config.channel_count, generator=generator) * 0.4
    return points, torch.randn(count, config.grasp_size, generator=generator) if config.use_grasp else None


def test_neither_batch_nor_order_of_points_matters(variant: ModelConfig, make_net) -> None:
    net = make_net(variant)
    points, grasp = inputs(variant)
    together = net(points, grasp)
    assert (net.features(points).shape, together.shape) == ((4, variant.feature_size), (4, variant.output_size))
    assert torch.isfinite(net.counts(points, grasp)).all()
    # not bit-equal: the matrix product may sum a row in another order at another place
    shuffled = points[:, torch.randperm(variant.n_points)]
    torch.testing.assert_close(net(shuffled, grasp), together, rtol=1e-5, atol=1e-6)
    single = [net(points[i : i + 1], None if grasp is None else grasp[i : i + 1]) for i in range(4)]
    torch.testing.assert_close(torch.cat(single), together, rtol=1e-5, atol=1e-6)


def test_gradient_reaches_every_parameter(variant: ModelConfig) -> None:
    torch.manual_seed(0)
    net = TouchNet(variant)
    if net.features.transform is not None:  # it starts at zero, where nothing before it would get a gradient
        torch.nn.init.normal_(net.features.transform.matrix.weight)
    points, grasp = inputs(variant, 8)
    (net(points, grasp) ** 2).sum().backward()
    for name, parameter in net.named_parameters():
        if name.endswith("linear.bias") and name.replace("linear.bias", "norm.bias") in dict(net.named_parameters()):
            continue  # batch norm takes its mean away again: no gradient by construction
        assert parameter.grad is not None, name
        assert parameter.grad.abs().max() > 0, name
