# SPDX-License-Identifier: Apache-2.0
"""Prediction: features once, mates without influence, flags, ensembles."""

import subprocess
import sys

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose

from foretouch.errors import CloudError, ModelError
from foretouch.models.familiarity import Familiarity, describe
from foretouch.models.folding import FoldedNetwork, fold
from foretouch.models.network_estimator import Member, NetworkEstimator
from foretouch.models.preparation import prepare_cloud, prepare_grasps
from foretouch.models.touch_model import TouchModel
from foretouch.tactile.modalities import MODALITIES, columns
from foretouch.types import Cloud, Grasp

CARD = {"name": "toy", "sha256": "0" * 64}


@pytest.fixture
def model(make_net, small) -> TouchModel:
    return TouchModel(NetworkEstimator([Member(small, fold(make_net()))]), CARD)


def vectors(predictions) -> np.ndarray:
    return np.array([p.value.vector() for p in predictions])


def test_prediction_is_that_of_the_network(model, make_net, small, can, make_grasps) -> None:
    grasps = make_grasps(5)
    prepared = prepare_cloud(can, small)
    fed = torch.from_numpy(prepare_grasps(grasps, prepared.frame, small))
    expected = make_net().counts(torch.from_numpy(prepared.points).expand(5, -1, -1), fed)
    predictions = model.predict(can, grasps)
    assert_allclose(vectors(predictions), expected.detach().numpy(), atol=5e-3)
    assert [p.grasp for p in predictions] == grasps
    assert {(p.status, p.reference, p.lower, p.upper) for p in predictions} == {("ok", "none", None, None)}


def test_features_are_computed_once(model, can, make_grasps, monkeypatch) -> None:
    calls = []
    original = FoldedNetwork.features
    monkeypatch.setattr(FoldedNetwork, "features", lambda self, x: calls.append(1) or original(self, x))
    model.predict(can, make_grasps(50))
    assert len(calls) == 1


def test_mates_have_no_influence(model, can, make_grasps) -> None:
    grasps = make_grasps(40)
    together = vectors(model.predict(can, grasps))
    alone = np.concatenate([vectors(model.predict(can, [grasp])) for grasp in grasps])
    assert np.array_equal(together, alone)
    assert np.array_equal(vectors(model.predict(can, grasps[::-1]))[::-1], together)


def test_deterministic_and_finite(model, can, make_grasps) -> None:
    grasps = make_grasps(3)
    first = vectors(model.predict(can, grasps))
    assert np.isfinite(first).all()
    assert np.array_equal(vectors(model.predict(can, grasps)), first)


def test_order_of_points_does_not_matter_where_all_are_used(model, can, make_grasps, rng) -> None:
    few = can.take(np.arange(64))
    grasps = make_grasps(2)
    shuffled = few.take(rng.permutation(64))
    assert_allclose(vectors(model.predict(shuffled, grasps)), vectors(model.predict(few, grasps)), atol=2e-2)


def test_no_grasp_gives_no_prediction(model, can) -> None:
    assert model.predict(can, []) == []


def test_values_beyond_the_ranges_are_flagged_and_kept(make_net, small, can, make_grasps) -> None:
    net = make_net()
    with torch.no_grad():
        net.target_mean[0] = 5000.0
    (prediction,) = TouchModel(NetworkEstimator([Member(small, fold(net))]), CARD).predict(can, make_grasps(1))
    assert "out_of_range" in prediction.flags
    assert prediction.value.pdc_th > 4000


def test_unfamiliar_clouds_and_grasps_are_flagged(make_net, small, can, make_grasps) -> None:
    grasps = make_grasps(20)
    lengths = describe(prepare_cloud(can, small), grasps)
    spans = Familiarity(lengths.min(axis=0) - 0.01, lengths.max(axis=0) + 0.01)
    model = TouchModel(NetworkEstimator([Member(small, fold(make_net()), spans)]), CARD)
    assert not any("unfamiliar" in p.flags for p in model.predict(can, grasps))
    back, aside = np.array([0.0, 0.0, 1.0]), np.array([0.5, 0.0, 0.0])
    far = Cloud((can.xyz + back).astype(np.float32))
    moved = [Grasp(g.g1 + back, g.g2 + back, g.rotation) for g in grasps]
    assert all("unfamiliar" in p.flags for p in model.predict(far, moved))
    beside = Grasp(grasps[0].g1 + aside, grasps[0].g2 + aside, grasps[0].rotation)
    assert ["unfamiliar" in p.flags for p in model.predict(can, [grasps[0], beside])] == [False, True]


def test_a_network_that_overflows_is_refused_by_name(make_net, small, can, make_grasps) -> None:
    net = make_net()
    with torch.no_grad():
        net.target_mean[3] = float("inf")
    (prediction,) = TouchModel(NetworkEstimator([Member(small, fold(net))]), CARD).predict(can, make_grasps(1))
    assert (prediction.status, prediction.value) == ("refused", None)
    assert "not finite" in prediction.reason


def test_ensemble_equals_its_members(make_net, small, can, make_grasps) -> None:
    grasps = make_grasps(4)
    nets = {name: make_net(small.replace(outputs=(name,)), seed=k) for k, name in enumerate(MODALITIES)}
    model = TouchModel(NetworkEstimator([Member(net.config, fold(net)) for net in nets.values()]), CARD)
    together = vectors(model.predict(can, grasps))
    for name, net in nets.items():
        prepared = prepare_cloud(can, net.config)
        fed = torch.from_numpy(prepare_grasps(grasps, prepared.frame, net.config))
        points = torch.from_numpy(prepared.points).expand(4, -1, -1)
        assert_allclose(together[:, columns([name])], net.counts(points, fed).detach().numpy(), atol=5e-3)


def test_members_must_share_the_modalities_out(make_net, small) -> None:
    twice = [Member(small, fold(make_net())), Member(small.replace(outputs=("E_TH",)), fold(make_net()))]
    with pytest.raises(ModelError, match="E_TH is predicted by 2 networks"):
        TouchModel(NetworkEstimator(twice), CARD)


def test_refusals_reach_the_caller(make_net, small, can, make_grasps) -> None:
    config = small.replace(channels="xyz+rgb")
    model = TouchModel(NetworkEstimator([Member(config, fold(make_net(config)))]), CARD)
    with pytest.raises(ModelError, match="has no rgb"):
        model.predict(Cloud(can.xyz), make_grasps(1))
    with pytest.raises(CloudError, match="fewer than 32"):
        model.predict(Cloud(can.xyz[:5], can.rgb[:5]), make_grasps(1))


def test_importing_models_does_not_import_torch() -> None:
    code = "import sys, foretouch.models; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
