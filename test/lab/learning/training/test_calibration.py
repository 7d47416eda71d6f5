# SPDX-License-Identifier: Apache-2.0
"""Calibration on made-up populations of objects whose lasting errors, noise and slopes are known."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from foretouch.models.calibration import Calibration, CalibrationGroup
from foretouch.models.tracker import SensorTracker
from foretouch.tactile import BIOTAC, MODALITIES
from foretouch_lab.learning.prequential import TimedReadings, replay
from foretouch_lab.learning.training.calibration import HeldOutPredictions, conformal_level, fit_group

SIZE = 50
W = np.linspace(100.0, 900.0, SIZE)


def lasting(rng: np.random.Generator) -> np.ndarray:
    """(50, 50) covariance in which values go together."""
    factors = rng.normal(size=(SIZE, 5))
    return 150.0 * (factors @ factors.T) + 200.0 * np.eye(SIZE)


def population(
    rng: np.random.Generator, between: np.ndarray, objects: int, each: int, kept: float = 1.0
) -> HeldOutPredictions:
    """Labels are an offset of the object, `kept` of each predicted difference, and noise of variance W."""
    owner = np.repeat(np.arange(objects), each)
    predicted = 30.0 * rng.normal(size=(len(owner), SIZE))
    centre = np.array([predicted[owner == k].mean(axis=0) for k in range(objects)])[owner]
    offsets = rng.multivariate_normal(np.zeros(SIZE), between, objects)
    noise = np.sqrt(W) * rng.normal(size=predicted.shape)
    labels = centre + kept * (predicted - centre) + offsets[owner] + noise
    who = np.array([f"object{k}" for k in owner])
    return HeldOutPredictions(predicted, labels, who, who, BIOTAC)


def of(residuals: np.ndarray, objects: list[str], sessions: list[str] | None = None) -> HeldOutPredictions:
    """The same residual in all values."""
    labels = np.tile(np.asarray(residuals, np.float64)[:, None], (1, SIZE))
    return HeldOutPredictions(np.zeros_like(labels), labels, np.array(objects), np.array(sessions or objects), BIOTAC)


def after_touches(group: CalibrationGroup, one: HeldOutPredictions, touches: int) -> tuple[np.ndarray, np.ndarray]:
    """Predictions and half widths of the samples of an object after the first ones."""
    calibration = Calibration(BIOTAC, np.zeros(SIZE), {"known": group, "new": group})
    # Residuals alone matter; readings must be those of a sensor.
    shift = 2000.0 * np.ones(SIZE)
    made = TimedReadings(np.ones(len(one.labels), np.int64), one.objects, one.labels + shift, one.predicted + shift)
    first = np.arange(len(one.labels)) < touches
    tracker, asked = SensorTracker(calibration.tracker_parameters), made.take(~first)
    replay(tracker, made.take(first))
    level = tracker.level(1, same_object=tracker.touches > 0, known=False)
    counts, half = tracker.adapt(level, asked.expected)
    return counts - shift, half


def test_few_objects_are_cut_higher_and_intervals_of_forty_hold_nine_in_ten_values_of_new_ones() -> None:
    levels = [conformal_level(objects) for objects in (1, 8, 18, 40, 10**9)]
    assert levels == pytest.approx([0.95, 0.95, 0.95, 0.9225, 0.9], abs=1e-6)
    covered: dict[str, list[float]] = {modality: [] for modality in MODALITIES}
    for seed in range(20):
        rng = np.random.default_rng(seed)
        B = lasting(rng)
        half = fit_group(population(rng, B, 40, 8)).half_width
        new = population(rng, B, 60, 5)
        inside = np.abs(new.labels - new.predicted) <= half
        for modality in MODALITIES:
            covered[modality].append(float(inside[:, BIOTAC.columns([modality])].mean()))
    for modality, shares in covered.items():
        assert 0.87 <= np.mean(shares) <= 0.95, modality


@pytest.mark.slow
@pytest.mark.parametrize("kept", [1.0, 0.4])
def test_after_three_touches_they_are_narrower_and_hold_as_many(kept: float) -> None:
    covered, narrowed = [], []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        B = lasting(rng)
        regime = fit_group(population(rng, B, 40, 12, kept))
        new = population(rng, B, 40, 40, kept)  # so many that the mean of what is predicted hardly matters
        for name in np.unique(new.objects):
            one = new.take(new.objects == name)
            after, half = after_touches(regime, one, 3)
            covered.append((np.abs(one.labels[3:] - after) <= half).mean())
        narrowed.append((half / regime.half_width).mean())
    assert 0.86 <= np.mean(covered) <= 0.96
    assert np.mean(narrowed) < 0.9


def test_every_object_weighs_the_same() -> None:
    """Twenty objects of errors 1 to 20 are cut at 0.945: the 19th, though the first has most samples."""
    errors = np.repeat(np.arange(1.0, 21.0), [100, *range(2, 20), 1])
    regime = fit_group(of(errors, [f"{e:02.0f}" for e in errors]))
    assert_allclose(regime.half_width, 19.0)
    few = fit_group(of([10.0, *[1.0] * 99], ["a", *["b"] * 99]))  # two objects, cut at 0.95
    assert_allclose(few.half_width, 10.0)


@pytest.mark.parametrize(("kept", "found"), [(0.0, 0.0), (0.4, 0.4), (1.0, 1.0), (1.7, 1.0), (-0.5, 0.0)])
def test_the_share_of_differences_that_holds_is_found(kept: float, found: float) -> None:
    rng = np.random.default_rng(3)
    regime = fit_group(population(rng, lasting(rng), 20, 30, kept))
    # 580 differences of deviation 30 in noise of up to 30: a standard error of 0.04 for a single value.
    assert_allclose(regime.difference_shrinkage, found, atol=0.1)
    for modality in MODALITIES:
        assert len(np.unique(regime.difference_shrinkage[BIOTAC.columns([modality])])) == 1


@pytest.mark.parametrize(("objects", "each"), [(2, 2), (8, 40), (40, 3), (100, 3), (300, 2)])
@pytest.mark.parametrize("errs", [False, True])
def test_the_covariance_is_positive_and_touches_never_blow_up(objects: int, each: int, errs: bool) -> None:
    rng = np.random.default_rng(objects)
    B = lasting(rng) if errs else np.zeros((SIZE, SIZE))
    regime = fit_group(population(rng, B, objects, each))
    assert np.linalg.eigvalsh(regime.between)[0] > 0.0
    assert (np.diag(regime.between) >= 0.05 * regime.within - 1e-9).all()
    Calibration.from_tensors(Calibration(BIOTAC, np.zeros(SIZE), {"known": regime, "new": regime}).to_tensors(), BIOTAC)
