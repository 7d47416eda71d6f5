# SPDX-License-Identifier: Apache-2.0
"""Prediction: features computed once, grasps of one call independent of each other, flags, ensembles, tare and touches."""

import subprocess
import sys

import numpy as np
import pytest
import torch
from calibrated_models import REST, make_calibration
from contact_model_builders import scaled, small_estimator
from experiment_samples import make_samples
from numpy.testing import assert_allclose, assert_array_equal

from foretouch.cloud.geometry.limits import ObjectLimits
from foretouch.errors import CloudError, ModelError, TactileError
from foretouch.grasp.reach import ReachConfig
from foretouch.models.network.checkpoint import Member, NetworkEstimator
from foretouch.models.network.folding import FoldedNetwork, fold
from foretouch.models.network.length_check import LengthRangeCheck, grasp_lengths
from foretouch.models.network.preparation import prepare_cloud, prepare_grasps
from foretouch.models.touch_model import ObjectResiduals, TouchModel
from foretouch.tactile import MODALITIES, columns
from foretouch.types import Cloud, Grasp, Touch

CARD = {"name": "toy", "sha256": "0" * 64}


@pytest.fixture
def model(make_net, small) -> TouchModel:
    return TouchModel(NetworkEstimator([Member(small, fold(make_net()))]), CARD)


SAMPLES = make_samples(5, 10)
SHIFT = np.linspace(-30.0, 60.0, 50)
TARE = Touch.from_vector(REST + SHIFT)


@pytest.fixture
def calibrated() -> TouchModel:
    """The contact model with a calibration."""
    return TouchModel(small_estimator(), CARD, make_calibration())


def residuals_of(model: TouchModel, count: int, tare: Touch | None = None) -> ObjectResiduals:
    """So many touches of the first object."""
    residuals = ObjectResiduals(model, tare)
    for sample in SAMPLES[:count]:
        residuals.add(sample.cloud, sample.grasp, sample.touch)
    return residuals


def bounds(predictions) -> np.ndarray:
    """(2, K, 50): lower and upper."""
    return np.array([[getattr(p, end).vector() for p in predictions] for end in ("lower", "upper")])


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


def test_grasps_of_one_call_are_independent(model, can, make_grasps) -> None:
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


def test_clouds_and_grasps_out_of_distribution_are_flagged(make_net, small, can, make_grasps) -> None:
    grasps = make_grasps(20)
    lengths = grasp_lengths(prepare_cloud(can, small), grasps)
    lengths_check = LengthRangeCheck(lengths.min(axis=0) - 0.01, lengths.max(axis=0) + 0.01)
    model = TouchModel(NetworkEstimator([Member(small, fold(make_net()), lengths_check)]), CARD)
    assert not any("unfamiliar" in p.flags for p in model.predict(can, grasps))
    back, aside = np.array([0.0, 0.0, 1.0]), np.array([0.5, 0.0, 0.0])
    far = Cloud((can.xyz + back).astype(np.float32))
    moved = [Grasp(g.g1 + back, g.g2 + back, g.rotation) for g in grasps]
    assert all("unfamiliar" in p.flags for p in model.predict(far, moved))
    beside = Grasp(grasps[0].g1 + aside, grasps[0].g2 + aside, grasps[0].rotation)
    wide = ReachConfig(max_distance_m=1.0)
    predictions = model.predict(can, [grasps[0], beside], reach=wide)
    assert ["unfamiliar" in p.flags for p in predictions] == [False, True]


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


def test_each_modality_must_be_predicted_by_one_member(make_net, small) -> None:
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


def test_without_tare_and_touches_it_is_the_estimate_with_the_interval_of_its_group(calibrated) -> None:
    sample = SAMPLES[3]
    predictions = calibrated.predict(sample.cloud, [sample.grasp])
    estimate = small_estimator().estimate(sample.cloud, [sample.grasp])
    half = calibrated.calibration.group(in_distribution=bool(estimate.in_distribution[0]), tare=False).half_width
    assert_array_equal(vectors(predictions), estimate.counts)
    assert_array_equal(bounds(predictions), [estimate.counts - half, estimate.counts + half])
    assert predictions[0].reference == "none"


def test_a_tare_shifts_by_its_distance_from_rest(calibrated) -> None:
    sample = SAMPLES[3]
    before, after = (calibrated.predict(sample.cloud, [sample.grasp], tare=tare) for tare in (None, TARE))
    assert_array_equal(vectors(after), vectors(before) + (TARE.vector() - REST))
    inside = "unfamiliar" not in after[0].flags
    half = calibrated.calibration.group(in_distribution=inside, tare=True).half_width
    assert_allclose(bounds(after)[1] - vectors(after), half[None], atol=1e-9)
    assert after[0].reference == "tare"


@pytest.mark.parametrize("tare", [None, TARE])
@pytest.mark.parametrize("touches", [1, 3])
def test_touches_shift_and_narrow_as_the_group_predicts(calibrated, tare, touches: int) -> None:
    residuals = residuals_of(calibrated, touches, tare)
    sample = SAMPLES[6]
    (prediction,) = calibrated.predict(sample.cloud, [sample.grasp], residuals=residuals)
    (before,) = calibrated.predict(sample.cloud, [sample.grasp], tare=tare)
    group = calibrated.calibration.group(in_distribution="unfamiliar" not in before.flags, tare=tare is not None)
    expected = np.mean([calibrated.expect(s.cloud, [s.grasp], tare)[0] for s in SAMPLES[:touches]], axis=0)
    read = np.mean([s.touch.vector() for s in SAMPLES[:touches]], axis=0)
    wanted = group.counts_after(before.value.vector()[None], expected, read, touches)
    assert_allclose(vectors([prediction]), wanted, rtol=1e-12)
    assert_allclose(bounds([prediction])[1] - wanted, group.half_width_after(touches)[None], atol=1e-9)
    assert prediction.reference == "touches"


def test_residuals_without_readings_are_their_tare(calibrated) -> None:
    sample = SAMPLES[6]
    for tare, reference in ((None, "none"), (TARE, "tare")):
        (empty,) = calibrated.predict(sample.cloud, [sample.grasp], residuals=ObjectResiduals(calibrated, tare))
        (wanted,) = calibrated.predict(sample.cloud, [sample.grasp], tare=tare)
        assert_array_equal(empty.value.vector(), wanted.value.vector())
        assert_array_equal(bounds([empty]), bounds([wanted]))
        assert empty.reference == wanted.reference == reference


def test_a_drift_that_tare_and_readings_share_changes_predictions_by_itself(calibrated) -> None:
    """As sensors read 25 counts more, all that changes is 25 counts."""
    sample, both = SAMPLES[6], []
    for drift in (0.0, 25.0):
        residuals = ObjectResiduals(calibrated, Touch.from_vector(REST + SHIFT + drift))
        for one in SAMPLES[:3]:
            residuals.add(one.cloud, one.grasp, Touch.from_vector(one.touch.vector() + drift))
        both.append(residuals)
    before, after = (
        vectors(calibrated.predict(sample.cloud, [sample.grasp], residuals=residuals)) for residuals in both
    )
    assert_allclose(after, before + 25.0, atol=1e-9)


def test_grasps_of_one_call_are_independent_after_tare_and_touches(calibrated) -> None:
    cloud, grasps = SAMPLES[6].cloud, [sample.grasp for sample in SAMPLES]
    for adapted in ({"tare": TARE}, {"residuals": residuals_of(calibrated, 3, TARE)}):
        together = calibrated.predict(cloud, grasps, **adapted)
        alone = [calibrated.predict(cloud, [grasp], **adapted)[0] for grasp in grasps]
        assert_array_equal(vectors(together), vectors(alone))
        assert_array_equal(bounds(together), bounds(alone))
    assert calibrated.predict(cloud, [], tare=TARE) == []


def test_an_object_unlike_those_of_training_is_flagged_and_has_the_interval_of_new_objects(calibrated) -> None:
    sample = SAMPLES[3]
    house = scaled(sample.cloud, 50.0)
    limits, reach = ObjectLimits(max_extent_m=10.0, max_range_m=100.0), ReachConfig(max_distance_m=1.0)
    (prediction,) = calibrated.predict(house, [sample.grasp], limits=limits, reach=reach)
    assert "unfamiliar" in prediction.flags
    half = calibrated.calibration.groups["new"].half_width
    assert_allclose(bounds([prediction])[1, 0] - prediction.value.vector(), half, atol=1e-9)


def test_prediction_leaves_the_residuals_unchanged(calibrated) -> None:
    residuals = residuals_of(calibrated, 3)
    before = np.array(residuals.means())
    calibrated.predict(SAMPLES[6].cloud, [SAMPLES[6].grasp], residuals=residuals)
    assert residuals.count == 3
    assert_array_equal(residuals.means(), before)


def test_without_a_calibration_tare_and_residuals_are_refused() -> None:
    bare, sample = TouchModel(small_estimator(), CARD), SAMPLES[0]
    with pytest.raises(ModelError, match="toy: tare: cannot be used: its card holds no rest level"):
        bare.predict(sample.cloud, [sample.grasp], tare=TARE)
    with pytest.raises(ModelError, match="toy: cannot adapt to touches: its card holds no calibration"):
        bare.predict(sample.cloud, [sample.grasp], residuals=ObjectResiduals(bare))
    (prediction,) = bare.predict(sample.cloud, [sample.grasp])
    assert (prediction.lower, prediction.upper, prediction.reference) == (None, None, "none")


def test_contradicting_arguments_are_refused(calibrated) -> None:
    sample = SAMPLES[0]
    with pytest.raises(ModelError, match="tare: the residuals have their own"):
        calibrated.predict(sample.cloud, [sample.grasp], tare=TARE, residuals=ObjectResiduals(calibrated))
    other = TouchModel(small_estimator(), {"name": "other", "sha256": "1" * 64}, make_calibration())
    with pytest.raises(ModelError, match="toy: residuals: are of other"):
        calibrated.predict(sample.cloud, [sample.grasp], residuals=residuals_of(other, 1))
    for tare in (np.zeros(50), np.full(50, np.nan)):
        with pytest.raises(TactileError, match=r"tare: pdc_th: (0|nan) is not between"):
            calibrated.predict(sample.cloud, [sample.grasp], tare=Touch.from_vector(tare))


def test_importing_models_does_not_import_torch() -> None:
    code = "import sys, foretouch.models; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_predictions_become_objects_when_they_are_read(calibrated) -> None:
    """One by one, in slices or all: the same objects, which hold the same numbers."""
    cloud, grasps = SAMPLES[0].cloud, [sample.grasp for sample in SAMPLES[:4]]
    one_by_one, together = calibrated.predict(cloud, grasps), calibrated.predict(cloud, grasps)
    last = one_by_one[-1]
    assert one_by_one[len(grasps) - 1] is last
    assert [*one_by_one][-1] is last
    assert one_by_one[1:] == [*one_by_one][1:]
    for one, other in zip([one_by_one[k] for k in range(len(grasps))], together, strict=True):
        for name in ("value", "lower", "upper"):
            assert np.array_equal(getattr(one, name).vector(), getattr(other, name).vector())
        assert (one.grasp, one.flags, one.status) == (other.grasp, other.flags, other.status)
    with pytest.raises(IndexError):
        one_by_one[len(grasps)]
