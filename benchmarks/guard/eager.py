# SPDX-License-Identifier: Apache-2.0
"""Networks of the papers as most public PointNets compute them: eager, with 1-D convolutions over channels first."""

from collections.abc import Callable

import torch
from torch import Tensor, nn

from foretouch.models.network.config import ModelConfig
from foretouch_lab.learning.network.networks import TouchNet


def made_net(config: ModelConfig, seed: int) -> TouchNet:
    """Random weights, batch norms that have seen data, outputs in counts."""
    torch.manual_seed(seed)
    net = TouchNet(config)
    net.set_scaling(torch.full((config.output_size,), 2500.0), torch.full((config.output_size,), 300.0))
    with torch.no_grad():
        for _ in range(3):
            net(torch.randn(8, config.n_points, config.channel_count) * 0.4, torch.randn(8, config.grasp_size))
    return net.eval()


def channels_first(net: TouchNet) -> Callable[[Tensor, Tensor], Tensor]:
    """A network with a T-Net as convolutions of the same weights: (B, N, C) points and (B, G) grasps to counts."""
    transform = net.features.transform
    shared, trunk = _convolutions(transform.points), _convolutions(net.features.layers)

    def counts(points: Tensor, grasp: Tensor) -> Tensor:
        matrix = transform.matrix(transform.cloud(shared(points.transpose(1, 2)).amax(dim=2))).view(-1, 3, 3)
        turned = torch.cat([points[..., :3] @ matrix, points[..., 3:]], dim=-1).transpose(1, 2)
        return net.regress(trunk(turned).amax(dim=2), grasp) * net.target_scale + net.target_mean

    return counts


def _convolutions(layers: nn.Sequential) -> nn.Sequential:
    modules: list[nn.Module] = []
    for layer in layers:
        convolution = nn.Conv1d(layer.linear.in_features, layer.linear.out_features, 1)
        convolution.weight.data = layer.linear.weight.data[:, :, None].clone()
        convolution.bias.data = layer.linear.bias.data.clone()
        modules += [convolution, layer.norm, nn.ReLU()]
    return nn.Sequential(*modules).eval()
