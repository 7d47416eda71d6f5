# SPDX-License-Identifier: Apache-2.0
"""The fitted tracker finds the drift of sensors whose drift is known, and predicts better than one that ignores it."""

from dataclasses import replace

import numpy as np
import pytest
from calibrated_models import REST
from numpy.testing import assert_array_equal

from foretouch.models.calibration import Calibration
from foretouch.models.registry import load_model
from foretouch.models.state_space import TrackerParameters
from foretouch.models.tracker import SensorTracker
from foretouch.tactile import BIOTAC
from foretouch_lab.learning.prequential import TimedReadings, replay
from foretouch_lab.learning.training.calibration import HeldOutPredictions, fit_group
from foretouch_lab.learning.training.tracker import fit_places, fit_tracker, widen_unread

DAY = 86400.0


def campaign(
    rng: np.random.Generator, drift: float, *, tares: bool = False, objects: int = 24, each: int = 8
) -> TimedReadings:
    """Objects on successive days; a level of all values that drifts over 10 days, objects of 20 counts, grasps of 20."""
    seconds = np.concatenate([DAY * k + 90.0 * np.arange(each) for k in range(objects)])
    level, levels = drift * rng.normal(size=50), []
    for gap in np.diff(seconds, prepend=seconds[0]):
        decay = np.exp(-gap / (10.0 * DAY))
        level = decay * level + drift * np.sqrt(1.0 - decay**2) * rng.normal(size=50)
        levels.append(level)
    lasting = np.repeat(rng.normal(0.0, 20.0, (objects, 50)), each, axis=0)
    readings = REST + np.array(levels) + lasting + rng.normal(0.0, 20.0, lasting.shape)
    names = np.repeat([f"o{k:02}" for k in range(objects)], each)
    offsets = np.array(levels) + rng.normal(0.0, 4.0, lasting.shape) if tares else None
    stamps = (1_700_000_000 + seconds) * 1e9
    return TimedReadings(stamps.astype(np.int64), names, readings, np.tile(REST, (len(names), 1)), offsets).ordered()


def fitted(recording: TimedReadings) -> TrackerParameters:
    held_out = HeldOutPredictions(recording.expected, recording.readings, recording.objects, recording.objects, BIOTAC)
    group = fit_group(held_out, new=True)
    return fit_tracker(recording, group, group)


def test_the_fit_finds_the_slopes_over_the_temperature(rng) -> None:
    """And leaves everything else as it is, so that readings without TDC are predicted as before."""
    plain = campaign(rng, 20.0)
    tdc = 2400.0 + np.cumsum(rng.normal(0.0, 30.0, (len(plain.stamps_ns), 2)), axis=0)
    slopes = np.concatenate([np.zeros(2), rng.normal(0.7, 0.05, 24), rng.normal(0.4, 0.05, 24)])
    warmed = plain.readings + slopes * (tdc - tdc[0])[:, BIOTAC.finger_of_value]
    recording = replace(plain, readings=warmed, tdc=tdc)
    found, without = fitted(recording), fitted(replace(recording, tdc=None))
    assert_array_equal(found.slope[:2], 0.0)
    assert np.abs(found.slope[[2, 26]] - [0.7, 0.4]).max() < 0.1
    for name, array in without.to_tensors().items():
        if name not in ("slope", "slope_sd"):
            assert_array_equal(getattr(found, name), array)
    errors = [np.mean((replay(SensorTracker(one), recording).counts - warmed) ** 2) for one in (found, without)]
    assert errors[0] < 0.8 * errors[1]


def test_on_another_campaign_it_beats_the_memory_and_its_intervals_cover(rng) -> None:
    first, second = campaign(rng, 60.0), campaign(rng, 60.0)
    held_out = HeldOutPredictions(first.expected, first.readings, first.objects, first.objects, BIOTAC)
    group = fit_group(held_out, new=True)
    played = replay(SensorTracker(fit_tracker(first, group, group)), second)
    forgetful = Calibration(BIOTAC, REST, {"known": group, "new": group}).tracker_parameters
    memory = replay(SensorTracker(forgetful), second, keep_sensors=False)
    errors = [np.mean((one.counts - second.readings) ** 2) for one in (played, memory)]
    untouched = second.touches() == 0
    begun = [np.mean((one.counts - second.readings)[untouched] ** 2) for one in (played, memory)]
    assert begun[0] < 0.7 * begun[1]
    assert errors[0] < 0.9 * errors[1]
    assert abs(np.mean(np.abs(played.counts - second.readings) <= played.half) - 0.9) < 0.03
    assert sum(map(bool, played.restarted)) <= 3  # limits at the 99th of 192 touches: about one in three campaigns


def placed(rng: np.random.Generator, recording: TimedReadings) -> TimedReadings:
    """The same readings, and a part that depends smoothly on the first of three features, otherwise on each object."""
    where, runs = rng.normal(size=(len(recording.stamps_ns), 3)), recording.runs()
    phase = rng.uniform(0.0, 2.0 * np.pi, (runs[-1] + 1, 50))[runs]
    return replace(recording, readings=recording.readings + 60.0 * np.sin(where[:, :1] + phase), where=where)


@pytest.mark.slow
def test_the_fit_finds_what_places_say_and_nothing_in_others(rng) -> None:
    """Shuffled within the objects, the same features say nothing: neither the fit nor the predictions take them up."""
    first, second = (placed(rng, campaign(rng, 0.0, objects=8, each=16)) for _ in range(2))
    order = np.concatenate([16 * k + rng.permutation(16) for k in range(8)])
    level = fitted(replace(first, where=None))
    found, shuffled = (fit_places(level, replace(first, where=rows)) for rows in (first.where, first.where[order]))
    assert found.where_ratio.min() > 0.0
    assert shuffled.where_ratio.max() < found.where_ratio.min()
    for name, array in level.to_tensors().items():
        if not name.startswith("where"):
            assert_array_equal(getattr(found, name), array)

    def error(parameters: TrackerParameters, where: np.ndarray | None) -> float:
        played = replay(SensorTracker(parameters), replace(second, where=where))
        later = second.touches() >= 3
        assert abs(np.mean((np.abs(played.counts - second.readings) <= played.half)[later]) - 0.9) < 0.04
        return float(np.mean((played.counts - second.readings)[later] ** 2))

    plain, alike = error(level, None), error(found, second.where)
    assert alike < 0.85 * plain
    assert error(shuffled, second.where[order]) > 0.98 * plain


def test_intervals_before_any_reading_are_widened_by_what_stays_with_an_object() -> None:
    """About to the widths asked, as far as what varies together admits; neither a tare nor the sensors' drift takes part."""
    calibration = load_model("contact-v3").calibration
    wanted = {name: 1.5 * group.half_width for name, group in calibration.groups.items()}
    wider = widen_unread(calibration.tracker, wanted["new"], wanted["known"])
    got = replace(calibration, tracker=wider).unread_half_widths
    for name, half in wanted.items():
        assert np.abs(got[name] / half - 1.0).max() < 0.11
        assert abs(np.mean(got[name] / half) - 1.0) < 0.02
    for name in ("slow", "fast", "noise", "factor", "basis"):
        assert_array_equal(getattr(wider, name), getattr(calibration.tracker, name))
    narrower = widen_unread(calibration.tracker, *(np.ones(50) for _ in range(2)))
    assert_array_equal(narrower.object, calibration.tracker.object)
