# SPDX-License-Identifier: Apache-2.0
"""The folded network, which is NumPy alone, against the one it was made from."""

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose, assert_array_equal

from foretouch.models.network.config import ModelConfig


def drawn(*shape: int) -> np.ndarray:
    return np.random.default_rng(0).normal(0.0, 0.4, shape).astype(np.float32)


def test_folded_equals_eager(variant: ModelConfig, make_net) -> None:
    net = make_net(variant)
    folded = net.folded()
    points, grasps = drawn(variant.n_points, variant.channel_count), drawn(21, variant.grasp_size)
    seen = torch.from_numpy(points)
    eager = net.counts(seen.expand(21, -1, -1), torch.from_numpy(grasps) if variant.use_grasp else None)
    assert_allclose(folded.features(points), net.features(seen[None])[0].detach().numpy(), rtol=1e-5, atol=1e-5)
    # counts of about 3000 in float32, whose last place is 2e-4
    assert_allclose(folded.regress(folded.features(points), grasps), eager.detach().numpy(), rtol=0, atol=5e-3)


def test_the_copy_uses_running_statistics_even_in_training_mode_and_does_not_follow(small, make_net) -> None:
    net = make_net()
    points = drawn(small.n_points, 3)
    folded = net.folded()
    before = folded.features(points)
    assert_array_equal(net.train().folded().features(points), before)
    with torch.no_grad():
        for parameter in net.parameters():
            parameter.add_(1.0)
    assert_array_equal(folded.features(points), before)


@pytest.mark.parametrize("widths", [(16, 8), (1024, 512, 256)], ids=str)
def test_a_prediction_does_not_depend_on_its_mates_but_for_rounding(small: ModelConfig, make_net, widths) -> None:
    config = small.replace(head_widths=widths)
    folded = make_net(config).folded()
    features = folded.features(drawn(config.n_points, 3))
    grasps = drawn(53, config.grasp_size)
    assert folded.regress(features, grasps[:0]).shape == (0, 50)
    together = folded.regress(features, grasps)
    alone = np.concatenate([folded.regress(features, grasp[None]) for grasp in grasps])
    assert_allclose(together, alone, rtol=1e-5)
    assert_allclose(folded.regress(features, grasps[::-1])[::-1], together, rtol=1e-5)
    assert_array_equal(folded.regress(features, grasps), together)
