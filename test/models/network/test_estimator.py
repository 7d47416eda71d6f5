# SPDX-License-Identifier: Apache-2.0
"""Networks with their fallback (predictions themselves: `test_touch_model.py`)."""

from dataclasses import replace

import numpy as np
import pytest
from contact_model_builders import scaled
from numpy.testing import assert_allclose, assert_array_equal

from foretouch.models.network.checkpoint import NetworkEstimator
from foretouch.models.network.folding import fold
from foretouch.models.novelty import Fallback
from foretouch.models.object_shape import object_sizes
from foretouch.tactile import BIOTAC
from foretouch.types import Cloud


@pytest.fixture
def cans(can: Cloud, rng: np.random.Generator) -> Fallback:
    """Twenty clouds of the same can."""
    views = [can.take(rng.permutation(can.size)[:600]) for _ in range(20)]
    sizes = np.array([object_sizes(view.xyz) for view in views])
    return Fallback.fit(BIOTAC, sizes, np.arange(1000.0, 2000.0).reshape(20, 50))


def test_predictions_fade_to_the_mean_as_an_object_leaves_training(make_net, small, can, cans, make_grasps) -> None:
    """The score is 1 at the can's own distance, whatever points were drawn, and 0 at that of one a fifth larger."""
    grasps, view = make_grasps(3), can.take(np.arange(600))

    def distance(cloud: Cloud) -> float:
        standard = (object_sizes(cloud.xyz) - cans.centre) / cans.scale
        return float(np.sort(np.abs(cans.known - standard).sum(axis=1))[:3].mean())

    slow = replace(cans, span=np.array([distance(view), distance(scaled(view, 1.2))]))
    plain, fading = (NetworkEstimator(small, fold(make_net()), None, one) for one in (None, slow))
    weights = []
    for factor in (1.0, 1.05, 1.1, 1.2, 30.0):
        larger = scaled(view, factor)
        direct, faded = (one.estimate(larger, grasps) for one in (plain, fading))
        weights.append(slow.score(object_sizes(larger.xyz)))
        assert_allclose(faded.counts, weights[-1] * direct.counts + (1.0 - weights[-1]) * cans.mean)
        assert faded.in_distribution.tolist() == [weights[-1] >= 0.5] * 3
        assert direct.in_distribution.all()
    assert (weights[0], *weights[3:]) == pytest.approx((1.0, 0.0, 0.0))
    assert (np.diff(weights[:4]) < 0.0).all()
    assert_array_equal(faded.counts, np.tile(np.arange(1475.0, 1525.0), (3, 1)))
    assert fading.estimate(view, []).in_distribution.shape == (0,)
