# SPDX-License-Identifier: Apache-2.0
"""Networks and what they fall back to (predictions themselves: `test_touch_model.py`)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from contact_model_builders import scaled
from numpy.testing import assert_array_equal

from foretouch.models.contact.features import ContactScene
from foretouch.models.network.estimator import Fallback, Member, NetworkEstimator
from foretouch.models.network.folding import fold
from foretouch.tactile.ranges import P1_RANGES, P2_RANGES
from foretouch.types import Cloud


@pytest.fixture
def cans(can: Cloud, rng: np.random.Generator) -> Fallback:
    """Twenty clouds of the same can."""
    views = [can.take(rng.permutation(can.size)[:600]) for _ in range(20)]
    objects = np.array([ContactScene(view.xyz).object_features for view in views])
    return Fallback.fit(objects, np.arange(1000.0, 2000.0).reshape(20, 50))


def test_an_object_of_another_size_is_unfamiliar_whatever_the_grasp(make_net, small, can, cans, make_grasps) -> None:
    estimator = NetworkEstimator([Member(small, fold(make_net()))], cans)
    view = can.take(np.arange(600))
    assert estimator.estimate(view, make_grasps(4)).familiar.tolist() == [True] * 4
    assert estimator.estimate(scaled(view, 3.0), make_grasps(4)).familiar.tolist() == [False] * 4
    assert estimator.estimate(view, []).familiar.shape == (0,)


def test_on_a_new_object_the_mean_of_the_labels_is_all_that_is_left(make_net, small, can, cans, make_grasps) -> None:
    grasps = make_grasps(3)
    plain, doubting = (NetworkEstimator([Member(small, fold(make_net()))], one) for one in (None, cans))
    house = scaled(can, 30.0)
    assert plain.estimate(house, grasps).familiar.all()
    assert_array_equal(doubting.estimate(house, grasps).counts, np.tile(np.arange(1475.0, 1525.0), (3, 1)))


def test_on_the_way_to_a_new_object_predictions_fade(make_net, small, can, cans, make_grasps) -> None:
    grasps = make_grasps(3)
    slow = replace(cans, novelty=replace(cans.novelty, span=np.array([50.0, 2000.0])))
    plain, doubting = (NetworkEstimator([Member(small, fold(make_net()))], one) for one in (None, slow))
    view = can.take(np.arange(600))
    weights = []
    for factor in np.linspace(1.0, 1.2, 41):
        larger = scaled(view, factor)
        said, faded = (one.estimate(larger, grasps) for one in (plain, doubting))
        weight = (faded.counts - cans.mean) / (said.counts - cans.mean)
        assert np.ptp(weight) < 1e-9
        assert faded.familiar.tolist() == [bool(weight[0, 0] >= 0.5)] * 3
        weights.append(float(weight[0, 0]))
    assert (weights[0], weights[-1]) == (1.0, 0.0)
    assert any(0.0 < weight < 1.0 for weight in weights)


def test_ranges_are_those_of_whoever_predicts_the_modality(make_net, small) -> None:
    thumb = small.replace(outputs=("PDC_TH", "E_TH"), ranges=P1_RANGES)
    finger = small.replace(outputs=("PDC_MF", "E_MF"))
    ranges = NetworkEstimator([Member(config, fold(make_net(config))) for config in (thumb, finger)]).ranges
    assert (ranges.of("E_TH"), ranges.of("E_MF")) == (P1_RANGES.of("E_TH"), P2_RANGES.of("E_MF"))
