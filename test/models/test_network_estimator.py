# SPDX-License-Identifier: Apache-2.0
"""Networks and the novelty of their training objects (predictions themselves: `test_touch_model.py`)."""

from __future__ import annotations

import numpy as np
import pytest
from contact_model_builders import scaled

from foretouch.models.contact_features import ContactScene
from foretouch.models.folding import fold
from foretouch.models.network_estimator import Member, NetworkEstimator
from foretouch.models.novelty import Novelty
from foretouch.tactile.ranges import P1_RANGES, P2_RANGES
from foretouch.types import Cloud


@pytest.fixture
def cans(can: Cloud, rng: np.random.Generator) -> Novelty:
    """Twenty clouds of the same can."""
    views = [can.take(rng.permutation(can.size)[:600]) for _ in range(20)]
    return Novelty.fit(np.array([ContactScene(view.xyz).object_features for view in views]))


def test_an_object_of_another_size_is_unfamiliar_whatever_the_grasp(make_net, small, can, cans, make_grasps) -> None:
    estimator = NetworkEstimator([Member(small, fold(make_net()))], cans)
    view = can.take(np.arange(600))
    assert estimator.estimate(view, make_grasps(4)).familiar.tolist() == [True] * 4
    assert estimator.estimate(scaled(view, 3.0), make_grasps(4)).familiar.tolist() == [False] * 4
    assert estimator.estimate(view, []).familiar.shape == (0,)


def test_novelty_does_not_touch_the_counts(make_net, small, can, cans, make_grasps) -> None:
    grasps = make_grasps(3)
    plain, doubting = (NetworkEstimator([Member(small, fold(make_net()))], one) for one in (None, cans))
    house = scaled(can, 30.0)
    assert np.array_equal(plain.estimate(house, grasps).counts, doubting.estimate(house, grasps).counts)
    assert plain.estimate(house, grasps).familiar.all()


def test_ranges_are_those_of_whoever_predicts_the_modality(make_net, small) -> None:
    thumb = small.replace(outputs=("PDC_TH", "E_TH"), ranges=P1_RANGES)
    finger = small.replace(outputs=("PDC_MF", "E_MF"))
    ranges = NetworkEstimator([Member(config, fold(make_net(config))) for config in (thumb, finger)]).ranges
    assert (ranges.of("E_TH"), ranges.of("E_MF")) == (P1_RANGES.of("E_TH"), P2_RANGES.of("E_MF"))
