# SPDX-License-Identifier: Apache-2.0
"""The folded network against the one it was made from."""

import pytest
import torch

from foretouch.models.network.config import ModelConfig
from foretouch.models.network.folding import BLOCK


def test_folded_equals_eager(variant: ModelConfig, make_net) -> None:
    net = make_net(variant)
    folded = net.folded()
    points = torch.randn(variant.n_points, variant.channel_count) * 0.4
    grasps = torch.randn(21, variant.grasp_size)
    eager = net.counts(points.expand(21, -1, -1), grasps if variant.use_grasp else None)
    torch.testing.assert_close(folded.features(points), net.features(points[None])[0], rtol=1e-5, atol=1e-5)
    # counts of about 3000 in float32, whose last place is 2e-4
    torch.testing.assert_close(folded.regress(folded.features(points), grasps), eager, rtol=0, atol=5e-3)


def test_the_copy_uses_running_statistics_even_in_training_mode_and_does_not_follow(small, make_net) -> None:
    net = make_net()
    points = torch.randn(small.n_points, 3)
    folded = net.folded()
    before = folded.features(points).clone()
    assert torch.equal(net.train().folded().features(points), before)
    with torch.no_grad():
        for parameter in net.parameters():
            parameter.add_(1.0)
    assert torch.equal(folded.features(points), before)


@pytest.mark.parametrize("widths", [(16, 8), (1024, 512, 256)], ids=str)
def test_a_prediction_is_bit_equal_whatever_its_mates(small: ModelConfig, make_net, widths) -> None:
    config = small.replace(head_widths=widths)
    folded = make_net(config).folded()
    features = folded.features(torch.randn(config.n_points, 3))
    grasps = torch.randn(3 * BLOCK + 5, config.grasp_size)
    assert folded.regress(features, grasps[:0]).shape == (0, 50)
    together = folded.regress(features, grasps)
    alone = torch.cat([folded.regress(features, grasp[None]) for grasp in grasps])
    assert torch.equal(together, alone)
    assert torch.equal(folded.regress(features, grasps.flip(0)).flip(0), together)
