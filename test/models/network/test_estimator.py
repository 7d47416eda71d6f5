# SPDX-License-Identifier: Apache-2.0
"""Networks with their fallback (predictions themselves: `test_touch_model.py`)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from contact_model_builders import scaled
from numpy.testing import assert_array_equal

from foretouch.models.contact.features import ContactScene
from foretouch.models.network.checkpoint import Member, NetworkEstimator
from foretouch.models.network.folding import fold
from foretouch.models.novelty import Fallback
from foretouch.tactile import P1_RANGES, P2_RANGES
from foretouch.types import Cloud


@pytest.fixture
def cans(can: Cloud, rng: np.random.Generator) -> Fallback:
    """Twenty clouds of the same can."""
    views = [can.take(rng.permutation(can.size)[:600]) for _ in range(20)]
    objects = np.array([ContactScene(view.xyz).object_features for view in views])
    return Fallback.fit(objects, np.arange(1000.0, 2000.0).reshape(20, 50))


def test_an_object_of_another_size_is_out_of_distribution_for_every_grasp(
    make_net, small, can, cans, make_grasps
) -> None:
    estimator = NetworkEstimator([Member(small, fold(make_net()))], cans)
    view = can.take(np.arange(600))
    assert estimator.estimate(view, make_grasps(4)).in_distribution.tolist() == [True] * 4
    assert estimator.estimate(scaled(view, 3.0), make_grasps(4)).in_distribution.tolist() == [False] * 4
    assert estimator.estimate(view, []).in_distribution.shape == (0,)


def test_on_a_novel_object_the_mean_of_the_labels_is_predicted(make_net, small, can, cans, make_grasps) -> None:
    grasps = make_grasps(3)
    plain, fading = (NetworkEstimator([Member(small, fold(make_net()))], one) for one in (None, cans))
    house = scaled(can, 30.0)
    assert plain.estimate(house, grasps).in_distribution.all()
    assert_array_equal(fading.estimate(house, grasps).counts, np.tile(np.arange(1475.0, 1525.0), (3, 1)))


def test_predictions_fade_as_an_object_leaves_the_distribution(make_net, small, can, cans, make_grasps) -> None:
    grasps = make_grasps(3)
    slow = replace(cans, novelty=replace(cans.novelty, span=np.array([50.0, 2000.0])))
    plain, fading = (NetworkEstimator([Member(small, fold(make_net()))], one) for one in (None, slow))
    view = can.take(np.arange(600))
    weights = []
    for factor in np.linspace(1.0, 1.2, 41):
        larger = scaled(view, factor)
        direct, faded = (one.estimate(larger, grasps) for one in (plain, fading))
        weight = (faded.counts - cans.mean) / (direct.counts - cans.mean)
        assert np.ptp(weight) < 1e-9
        assert faded.in_distribution.tolist() == [bool(weight[0, 0] >= 0.5)] * 3
        weights.append(float(weight[0, 0]))
    assert (weights[0], weights[-1]) == (1.0, 0.0)
    assert any(0.0 < weight < 1.0 for weight in weights)


def test_ranges_are_those_of_the_network_that_predicts_the_modality(make_net, small) -> None:
    thumb = small.replace(outputs=("PDC_TH", "E_TH"), ranges=P1_RANGES)
    finger = small.replace(outputs=("PDC_MF", "E_MF"))
    ranges = NetworkEstimator([Member(config, fold(make_net(config))) for config in (thumb, finger)]).ranges
    assert (ranges.of("E_TH"), ranges.of("E_MF")) == (P1_RANGES.of("E_TH"), P2_RANGES.of("E_MF"))
