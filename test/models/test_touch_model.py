# SPDX-License-Identifier: Apache-2.0
"""Prediction: features computed once, grasps of one call independent of each other, flags, tare and history."""

import numpy as np
import pytest
import torch
from calibrated_models import REST, make_calibration, make_tracked_calibration
from contact_model_builders import scaled, small_estimator
from every_case import every_case
from experiment_samples import make_samples
from numpy.testing import assert_allclose, assert_array_equal

from foretouch.cloud.geometry.limits import ObjectLimits
from foretouch.errors import ModelError, TactileError
from foretouch.grasp.reach import ReachConfig
from foretouch.models.network.checkpoint import Network, NetworkPredictor
from foretouch.models.network.folding import FoldedNetwork
from foretouch.models.network.preparation import LengthRangeCheck, grasp_lengths, prepare_cloud, prepare_grasps
from foretouch.models.touch_model import History, TouchModel
from foretouch.tactile import biotac_touch
from foretouch.types import Cloud, Grasp, Touch

CARD = {"name": "toy", "sha256": "0" * 64}
SAMPLES = make_samples(5, 10)
TARE = biotac_touch(REST + np.linspace(-30.0, 60.0, 50))


@pytest.fixture
def model(make_net, small) -> TouchModel:
    return TouchModel(NetworkPredictor([Network(small, make_net().folded())]), CARD)


@pytest.fixture
def calibrated() -> TouchModel:
    """The contact model with a calibration."""
    return TouchModel(small_estimator(), CARD, make_calibration())


def touched(model: TouchModel, count: int, tare: Touch | None = None) -> History:
    """After so many touches of the first object."""
    history = History(model)
    for sample in SAMPLES[:count]:
        if tare is not None:
            history.tare(tare, stamp_ns=sample.stamp_ns)
        history.touched(sample.cloud, sample.grasp, sample.touch, stamp_ns=sample.stamp_ns, same_object=True)
    return history.at(SAMPLES[count].stamp_ns, same_object=True, tared=tare is not None)


def bounds(predictions) -> np.ndarray:
    """(2, K, 50): lower and upper."""
    return np.array([[getattr(p, end).values for p in predictions] for end in ("lower", "upper")])


def vectors(predictions) -> np.ndarray:
    return np.array([p.value.values for p in predictions])


def test_prediction_is_that_of_the_network(model, make_net, small, can, make_grasps, monkeypatch) -> None:
    """Features are computed once, whatever the grasps."""
    grasps = make_grasps(40)
    prepared = prepare_cloud(can, small)
    fed = torch.from_numpy(prepare_grasps(grasps, prepared.frame, small))
    expected = make_net().counts(torch.from_numpy(prepared.points).expand(40, -1, -1), fed).detach().numpy()
    calls, original = [], FoldedNetwork.features
    monkeypatch.setattr(FoldedNetwork, "features", lambda self, x: calls.append(1) or original(self, x))
    predictions = model.predict(can, grasps)
    assert len(calls) == 1
    assert_allclose(vectors(predictions), expected, atol=5e-3)
    assert [p.grasp.id for p in predictions] == [grasp.id for grasp in grasps]
    assert {(p.status, p.reference, p.calibrated) for p in predictions} == {("ok", "none", False)}
    assert model.predict(can, []).value.shape == (0, 50)


def test_grasps_of_one_call_are_independent_but_for_rounding(model, calibrated, can, make_grasps) -> None:
    def check(model: TouchModel, cloud: Cloud, grasps: list[Grasp], **readings) -> None:
        together = model.predict(cloud, grasps, **readings)
        alone = [model.predict(cloud, [grasp], **readings)[0] for grasp in grasps]
        assert_allclose(vectors(together), vectors(alone), rtol=1e-5)
        assert_allclose(vectors(model.predict(cloud, grasps[::-1], **readings))[::-1], vectors(together), rtol=1e-5)
        if readings:
            assert_allclose(bounds(together), bounds(alone), rtol=1e-5)

    check(model, can, make_grasps(40))
    cloud, grasps = SAMPLES[6].cloud, [sample.grasp for sample in SAMPLES]
    check(calibrated, cloud, grasps, tare=TARE)
    check(calibrated, cloud, grasps, history=touched(calibrated, 3, TARE))
    assert len(calibrated.predict(cloud, [], tare=TARE)) == 0


def test_values_out_of_range_are_flagged_and_overflow_is_refused(make_net, small, can, make_grasps) -> None:
    found = []
    for column, value in ((0, 5000.0), (3, float("inf"))):
        net = make_net()
        with torch.no_grad():
            net.target_mean[column] = value
        found += TouchModel(NetworkPredictor([Network(small, net.folded())]), CARD).predict(can, make_grasps(1))
    beyond, overflown = found
    assert "out_of_range" in beyond.flags
    assert beyond.value["PDC_TH"][0] > 4000
    assert (overflown.status, np.isnan(overflown.value.values).all()) == ("refused", True)
    assert "not finite" in overflown.reason


def test_clouds_and_grasps_out_of_distribution_are_flagged(make_net, small, can, make_grasps) -> None:
    grasps = make_grasps(20)
    lengths = grasp_lengths(prepare_cloud(can, small), grasps)
    lengths_check = LengthRangeCheck(lengths.min(axis=0) - 0.01, lengths.max(axis=0) + 0.01)
    model = TouchModel(NetworkPredictor([Network(small, make_net().folded(), lengths_check)]), CARD)
    assert not any("unfamiliar" in p.flags for p in model.predict(can, grasps))
    back, aside = np.array([0.0, 0.0, 1.0]), np.array([0.5, 0.0, 0.0])
    far = Cloud((can.xyz + back).astype(np.float32))
    moved = [Grasp(g.g1 + back, g.g2 + back, g.rotation) for g in grasps]
    assert all("unfamiliar" in p.flags for p in model.predict(far, moved))
    beside = Grasp(grasps[0].g1 + aside, grasps[0].g2 + aside, grasps[0].rotation)
    wide = ReachConfig(max_distance_m=1.0)
    predictions = model.predict(can, [grasps[0], beside], reach=wide)
    assert ["unfamiliar" in p.flags for p in predictions] == [False, True]


def test_without_readings_it_is_the_estimate_with_the_interval_of_its_group() -> None:
    """Objects like those of training and others; a hand of which nothing was read yet is not a reading."""
    sample, limits = SAMPLES[3], ObjectLimits(max_extent_m=10.0, max_range_m=100.0)
    house, reach = scaled(sample.cloud, 50.0), ReachConfig(max_distance_m=1.0)

    def check(calibration, cloud: Cloud, group: str) -> None:
        model = TouchModel(small_estimator(), CARD, calibration)
        estimate = small_estimator().estimate(cloud, [sample.grasp])
        unread = History(model).at(5, same_object=True)
        for history in (None, unread):
            (found,) = model.predict(cloud, [sample.grasp], history=history, limits=limits, reach=reach)
            half = calibration.unread_half_widths[group]
            assert_array_equal(vectors([found]), estimate.counts)
            assert_array_equal(bounds([found]), [estimate.counts - half, estimate.counts + half])
            assert (found.reference, "unfamiliar" in found.flags) == ("none", group == "new")

    known = "known" if small_estimator().estimate(sample.cloud, [sample.grasp]).familiar[0] else "new"
    cases = [
        (calibration, cloud, group)
        for calibration in (make_calibration(), make_tracked_calibration())
        for cloud, group in ((sample.cloud, known), (house, "new"))
    ]
    every_case(cases, check)


def test_readings_without_a_calibration_and_contradicting_arguments_are_refused(calibrated) -> None:
    bare, sample, history = TouchModel(small_estimator(), CARD), SAMPLES[0], touched(calibrated, 1)
    rule = "toy: cannot adapt to readings: its card holds no calibration"
    with pytest.raises(ModelError, match=rule):
        bare.predict(sample.cloud, [sample.grasp], tare=TARE)
    with pytest.raises(ModelError, match=rule):
        History(bare)
    (prediction,) = bare.predict(sample.cloud, [sample.grasp])
    assert (prediction.calibrated, prediction.reference) == (False, "none")
    with pytest.raises(ModelError, match="history: has tares and touches of its own"):
        calibrated.predict(sample.cloud, [sample.grasp], tare=TARE, history=history)
    other = TouchModel(small_estimator(), CARD, make_tracked_calibration())
    with pytest.raises(ModelError, match="toy: history: is of another model"):
        other.predict(sample.cloud, [sample.grasp], history=history)
    with pytest.raises(ModelError, match=rule):
        bare.predict(sample.cloud, [sample.grasp], history=history)
    for tare in (np.zeros(50), np.full(50, np.nan)):
        with pytest.raises(TactileError, match=r"tare: pdc_th: (0 is not between|was not read)"):
            calibrated.predict(sample.cloud, [sample.grasp], tare=biotac_touch(tare))
